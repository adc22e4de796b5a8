"""The test of ranges against claimed positions: its false alarm rate, and who is named for which fault."""

import numpy as np
import pytest

from gcs_coloc.core.integrity.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.fault_tests import FaultKind, SignificanceLevels, run_tests

SIGMA_GPS_M, SIGMA_RANGE_M = 1.5, 0.6
TRUE = {
    1: (0.0, 0.0, 100.0),
    2: (1200.0, 100.0, 120.0),
    3: (300.0, 1400.0, 90.0),
    4: (-900.0, 700.0, 140.0),
    5: (200.0, 600.0, 110.0),
}


def judge(now, levels, then=None, correlation=0.0):
    (verdict,) = run_tests(now, levels, [(then, correlation)])
    return verdict


def scene(rng, *, mutual, lies=None, free=(5,), pair_error=None, device_error=None):
    places, rows = {}, []
    for vehicle, true in TRUE.items():
        off = np.array([8.0, -6.0, 0.5]) if vehicle in free else SIGMA_GPS_M * rng.standard_normal(3)
        off = off + np.array((lies or {}).get(vehicle, (0.0, 0.0, 0.0)))
        places[vehicle] = PositionPrior(np.array(true) + off, SIGMA_GPS_M, SIGMA_GPS_M, vehicle in free)
    for i in TRUE:
        for j in TRUE:
            if i != j and (i == 5 or (mutual and j != 5)):
                measured = np.linalg.norm(np.subtract(TRUE[i], TRUE[j])) + SIGMA_RANGE_M * rng.standard_normal()
                measured += (pair_error or {}).get((i, j), 0.0) + (device_error or {}).get(i, 0.0)
                claimed = np.linalg.norm(places[i].position_enu_m - places[j].position_enu_m)
                rows.append(RangeResidual(i, j, float(measured - claimed), SIGMA_RANGE_M))
    return Epoch(0.0, places, tuple(rows))


@pytest.mark.parametrize("mutual", [True, False])
def test_the_false_alarm_rate_is_the_one_that_is_set(mutual):
    """600 sound scenes at an alarm level of 4 %: 24 expected, sigma 4.8; the band is four sigmas to either side."""
    rng = np.random.default_rng(7)
    verdicts = [judge(scene(rng, mutual=mutual), SignificanceLevels(alarm=0.04)) for _ in range(600)]
    assert 5 <= sum(not v.consistent for v in verdicts if v is not None) <= 43


def test_a_free_place_far_off_costs_nothing():
    """The statistic of a denied vehicle that is placed 10 m off is chi-square with the rows less its two unknowns."""
    rng = np.random.default_rng(1)
    verdicts = [judge(scene(rng, mutual=False), SignificanceLevels()) for _ in range(400)]
    assert {v.degrees_of_freedom for v in verdicts} == {2}
    # Mean of 400 values of variance 4: sigma 0.1, band of four.
    assert np.mean([v.statistic for v in verdicts]) == pytest.approx(2.0, abs=0.4)


@pytest.mark.parametrize("liar", [1, 2, 3, 4])
def test_with_mutual_ranges_a_liar_is_named_alone_and_its_lie_measured(liar):
    """A lie of 20 m is thirteen sigmas: always found, the liar always possible, and in nine of ten scenes nobody else is."""
    rng = np.random.default_rng(liar)
    alone = 0
    for _ in range(40):
        verdict = judge(scene(rng, mutual=True, lies={liar: (16.0, -12.0, 0.0)}), SignificanceLevels())
        assert not verdict.consistent
        named = {s.vehicles: s for s in verdict.possible}
        # The error of a position from four ranges to claims of 1.5 m: three sigmas of 2.5 m.
        assert named[(liar,)].size_m == pytest.approx(20.0, abs=7.5)
        alone += len(named) == 1
    assert alone >= 36


def test_with_one_range_to_the_liar_nobody_is_named_alone():
    """The range itself may as well be at fault: the liar is among the possible ones, always beside a pair."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        verdict = judge(scene(rng, mutual=False, lies={2: (-60.0, 0.0, 0.0)}), SignificanceLevels())
        assert not verdict.consistent
        kinds = {s.kind for s in verdict.possible}
        assert FaultKind.PAIR in kinds
        assert (2,) in {s.vehicles for s in verdict.possible if s.kind is FaultKind.VEHICLE}


def test_a_bad_range_between_two_honest_vehicles_is_not_blamed_on_either():
    rng = np.random.default_rng(4)
    for _ in range(40):
        verdict = judge(scene(rng, mutual=True, pair_error={(1, 3): 25.0, (3, 1): 25.0}), SignificanceLevels())
        assert [(s.kind, s.vehicles) for s in verdict.possible] == [(FaultKind.PAIR, (1, 3))]


def test_a_biased_device_is_not_taken_for_a_lying_receiver():
    rng = np.random.default_rng(5)
    for _ in range(40):
        verdict = judge(scene(rng, mutual=True, device_error={4: 15.0}), SignificanceLevels())
        assert [(s.kind, s.vehicles) for s in verdict.possible] == [(FaultKind.DEVICE, (4,))]


def test_two_liars_who_lie_alike_accuse_nobody_wrongly():
    """An area spoofer takes two of four along: whatever is possible, no honest vehicle is named alone."""
    rng = np.random.default_rng(6)
    for _ in range(40):
        verdict = judge(scene(rng, mutual=True, lies={1: (25.0, 0.0, 0.0), 2: (25.0, 0.0, 0.0)}), SignificanceLevels())
        named = {s.vehicles for s in verdict.possible}
        assert named not in ({(3,)}, {(4,)})


def test_without_redundancy_there_is_no_verdict():
    full = scene(np.random.default_rng(0), mutual=False)
    assert judge(Epoch(0.0, full.places, full.rows[:2]), SignificanceLevels()) is None
    assert judge(Epoch(0.0, full.places, ()), SignificanceLevels()) is None


def wandered(rng, before, share):
    """The scene some time later: every claim's error kept by that share, the rest drawn anew, and new ranges."""
    later = scene(rng, mutual=True)
    keep = np.sqrt(1.0 - share**2)
    places = {}
    for vehicle, place in later.places.items():
        then, now = before.places[vehicle].position_enu_m - TRUE[vehicle], place.position_enu_m - TRUE[vehicle]
        error = now if place.free else share * then + keep * now
        places[vehicle] = PositionPrior(np.array(TRUE[vehicle]) + error, place.sigma_h_m, place.sigma_v_m, place.free)
    rows = []
    for row in later.rows:
        claims = [places[v].position_enu_m for v in row.pair]
        drawn = [later.places[v].position_enu_m for v in row.pair]
        range_m = row.residual_m + np.linalg.norm(drawn[0] - drawn[1])
        rows.append(RangeResidual(*row.pair, float(range_m - np.linalg.norm(claims[0] - claims[1])), row.sigma_m))
    return Epoch(5.0, places, tuple(rows))


def test_errors_that_wander_as_assumed_make_the_statistic_of_two_scenes_chi_square():
    rng = np.random.default_rng(8)
    verdicts = []
    for _ in range(300):
        before = scene(rng, mutual=True)
        verdicts.append(judge(wandered(rng, before, 0.9), SignificanceLevels(), before, 0.9))
    degrees = {v.degrees_of_freedom for v in verdicts}
    assert degrees == {2 * (16 - 2)}
    # Mean of 300 values of variance 56: sigma 0.43, band of four.
    assert np.mean([v.statistic for v in verdicts]) == pytest.approx(28.0, abs=1.8)


def test_a_lie_too_small_beside_the_stated_error_shows_in_its_change():
    """5 m are hidden by receivers of 1.5 m, but not where errors keep 95 % of themselves between the scenes."""
    rng = np.random.default_rng(9)
    alone, changed, named = 0, 0, 0
    for _ in range(40):
        before = scene(rng, mutual=True)
        honest = wandered(rng, before, 0.95)
        lie = np.array([4.0, -3.0, 0.0])
        places = dict(honest.places)
        places[2] = PositionPrior(places[2].position_enu_m + lie, SIGMA_GPS_M, SIGMA_GPS_M, free=False)
        rows = []
        for row in honest.rows:
            was = np.linalg.norm(np.subtract(*(honest.places[v].position_enu_m for v in row.pair)))
            now = np.linalg.norm(np.subtract(*(places[v].position_enu_m for v in row.pair)))
            rows.append(RangeResidual(*row.pair, float(row.residual_m + was - now), row.sigma_m))
        lying = Epoch(5.0, places, tuple(rows))
        alone += not judge(lying, SignificanceLevels()).consistent
        verdict = judge(lying, SignificanceLevels(), before, 0.95)
        changed += not verdict.consistent
        named += {s.vehicles for s in verdict.possible if s.kind is FaultKind.VEHICLE} == {(2,)}
    assert alone <= 4
    assert changed >= 36
    assert named >= 30


def test_what_a_liar_did_to_a_vehicle_without_gps_is_where_it_would_be_without_the_liar():
    """The vehicle is placed 10 m off: without a lie its offset is just that; with one of 20 m the doubt is what it adds."""
    rng = np.random.default_rng(10)
    offsets = [judge(scene(rng, mutual=True), SignificanceLevels()).offset_m[5] for _ in range(40)]
    # Where four ranges put it against claims of 1.5 m: sigma about 1.5 m per axis, of the mean of 40 about 0.25 m.
    np.testing.assert_allclose(np.mean(offsets, axis=0), [-8.0, 6.0], atol=1.0)
    quiet = judge(scene(rng, mutual=True), SignificanceLevels())
    assert not quiet.doubt_m2[5].any()
    loud = judge(scene(rng, mutual=True, lies={1: (16.0, -12.0, 0.0)}), SignificanceLevels())
    # The offset without the liar is the 10 m again, to three sigmas of the place that three ranges give.
    assert np.sqrt(np.trace(loud.doubt_m2[5])) == pytest.approx(10.0, abs=7.0)
