"""The test of ranges against claimed positions: its false alarm rate, and who is named for which fault."""

import numpy as np
import pytest

from gcs_coloc.core.exclusion import Kind, Levels, Place, Row, judge

SIGMA_GPS_M, SIGMA_RANGE_M = 1.5, 0.6
TRUE = {
    1: (0.0, 0.0, 100.0),
    2: (1200.0, 100.0, 120.0),
    3: (300.0, 1400.0, 90.0),
    4: (-900.0, 700.0, 140.0),
    5: (200.0, 600.0, 110.0),
}


def scene(rng, *, mutual, lies=None, free=(5,), pair_error=None, device_error=None):
    places, rows = {}, []
    for vehicle, true in TRUE.items():
        off = np.array([8.0, -6.0, 0.5]) if vehicle in free else SIGMA_GPS_M * rng.standard_normal(3)
        off = off + np.array((lies or {}).get(vehicle, (0.0, 0.0, 0.0)))
        places[vehicle] = Place(np.array(true) + off, SIGMA_GPS_M, SIGMA_GPS_M, vehicle in free)
    for i in TRUE:
        for j in TRUE:
            if i != j and (i == 5 or (mutual and j != 5)):
                measured = np.linalg.norm(np.subtract(TRUE[i], TRUE[j])) + SIGMA_RANGE_M * rng.standard_normal()
                measured += (pair_error or {}).get((i, j), 0.0) + (device_error or {}).get(i, 0.0)
                claimed = np.linalg.norm(places[i].position_enu_m - places[j].position_enu_m)
                rows.append(Row(i, j, float(measured - claimed), SIGMA_RANGE_M))
    return places, rows


@pytest.mark.parametrize("mutual", [True, False])
def test_the_false_alarm_rate_is_the_one_that_is_set(mutual):
    """600 sound scenes at an alarm level of 4 %: 24 expected, sigma 4.8; the band is four sigmas to either side."""
    rng = np.random.default_rng(7)
    verdicts = [judge(*scene(rng, mutual=mutual), Levels(alarm=0.04)) for _ in range(600)]
    assert 5 <= sum(not v.consistent for v in verdicts if v is not None) <= 43


def test_a_free_place_far_off_costs_nothing():
    """The statistic of a subject that is placed 10 m off is chi-square with the rows less its two unknowns."""
    rng = np.random.default_rng(1)
    verdicts = [judge(*scene(rng, mutual=False), Levels()) for _ in range(400)]
    assert {v.degrees_of_freedom for v in verdicts} == {2}
    # Mean of 400 values of variance 4: sigma 0.1, band of four.
    assert np.mean([v.statistic for v in verdicts]) == pytest.approx(2.0, abs=0.4)


@pytest.mark.parametrize("liar", [1, 2, 3, 4])
def test_with_mutual_ranges_a_liar_is_named_alone_and_its_lie_measured(liar):
    """A lie of 20 m is thirteen sigmas: always found, the liar always possible, and in nine of ten scenes nobody else is."""
    rng = np.random.default_rng(liar)
    alone = 0
    for _ in range(40):
        verdict = judge(*scene(rng, mutual=True, lies={liar: (16.0, -12.0, 0.0)}), Levels())
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
        verdict = judge(*scene(rng, mutual=False, lies={2: (-60.0, 0.0, 0.0)}), Levels())
        assert not verdict.consistent
        kinds = {s.kind for s in verdict.possible}
        assert Kind.PAIR in kinds
        assert (2,) in {s.vehicles for s in verdict.possible if s.kind is Kind.VEHICLE}


def test_a_bad_range_between_two_honest_vehicles_is_not_blamed_on_either():
    rng = np.random.default_rng(4)
    for _ in range(40):
        verdict = judge(*scene(rng, mutual=True, pair_error={(1, 3): 25.0, (3, 1): 25.0}), Levels())
        assert [(s.kind, s.vehicles) for s in verdict.possible] == [(Kind.PAIR, (1, 3))]


def test_a_biased_device_is_not_taken_for_a_lying_receiver():
    rng = np.random.default_rng(5)
    for _ in range(40):
        verdict = judge(*scene(rng, mutual=True, device_error={4: 15.0}), Levels())
        assert [(s.kind, s.vehicles) for s in verdict.possible] == [(Kind.DEVICE, (4,))]


def test_two_liars_who_lie_alike_accuse_nobody_wrongly():
    """An area spoofer takes two of four along: whatever is possible, no honest vehicle is named alone."""
    rng = np.random.default_rng(6)
    for _ in range(40):
        verdict = judge(*scene(rng, mutual=True, lies={1: (25.0, 0.0, 0.0), 2: (25.0, 0.0, 0.0)}), Levels())
        named = {s.vehicles for s in verdict.possible}
        assert named not in ({(3,)}, {(4,)})


def test_without_redundancy_there_is_no_verdict():
    places, rows = scene(np.random.default_rng(0), mutual=False)
    assert judge(places, rows[:2], Levels()) is None
    assert judge(places, [], Levels()) is None
