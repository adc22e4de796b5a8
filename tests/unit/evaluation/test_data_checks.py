"""Data checks find other units, axes and clocks than the columns say, and nothing in sound data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gcs_coloc.evaluation.data_checks.checks import check_delays, run_checks
from gcs_coloc.evaluation.data_checks.findings import FindingKind
from gcs_coloc.evaluation.data_checks.recorded_data import PositionTrack, RecordedData, position_track

END_S = 120.0
LOST_S = 30.0
DENIED = 4
SIGMA_GPS_M, SIGMA_RANGE_M = 1.0, 0.5


def path(vehicle: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a vehicle is and how fast: circles of their own places, sizes and directions, climbing and sinking."""
    east_m, north_m, height_m, radius_m, rate = [
        (0.0, 0.0, 100.0, 250.0, 0.08),
        (1500.0, 200.0, 160.0, 300.0, -0.07),
        (300.0, 1400.0, 130.0, 280.0, 0.06),
        (700.0, 500.0, 145.0, 350.0, -0.06),
    ][vehicle - 1]
    angle = rate * t + vehicle
    place = np.column_stack(
        (
            east_m + radius_m * np.cos(angle),
            north_m + radius_m * np.sin(angle),
            height_m + 10.0 * np.sin(t / 20.0 + vehicle),
        )
    )
    speed = radius_m * rate
    velocity = np.column_stack((-speed * np.sin(angle), speed * np.cos(angle), 0.5 * np.cos(t / 20.0 + vehicle)))
    return place, velocity


def fleet(seed: int) -> RecordedData:
    """Four aircraft with positions at 5 Hz; the fourth has none from 30 s on, ranges to the others at 5 Hz, and a truth."""
    rng = np.random.default_rng(seed)
    reports, altitudes = {}, {}
    for vehicle in (1, 2, 3, DENIED):
        t = np.arange(0.0, LOST_S if vehicle == DENIED else END_S, 0.2)
        place, velocity = path(vehicle, t)
        place = place + rng.normal(0.0, SIGMA_GPS_M, place.shape)
        velocity = velocity + rng.normal(0.0, 0.3, place.shape)
        reports[vehicle] = position_track(np.column_stack((t, place, np.full(len(t), SIGMA_GPS_M), velocity)))
        t = np.arange(0.0, END_S, 0.5)
        up_m = path(vehicle, t)[0][:, 2] + rng.normal(0.0, 1.0, len(t))
        altitudes[vehicle] = np.column_stack((t, up_m, np.full(len(t), 1.0)))
    t = np.arange(0.1, END_S, 0.2)
    rows = []
    for peer in (1, 2, 3):
        distance_m = np.linalg.norm(path(DENIED, t)[0] - path(peer, t)[0], axis=1) + rng.normal(0.0, SIGMA_RANGE_M, len(t))
        ends = np.full((len(t), 2), (DENIED, peer))
        rows.append(np.column_stack((t, ends, distance_m, np.full(len(t), SIGMA_RANGE_M))))
    t = np.arange(0.0, END_S, 0.5)
    truth = {DENIED: PositionTrack(t, path(DENIED, t)[0], np.zeros(len(t)))}
    return RecordedData({v: f"UAV{v}" for v in reports}, reports, truth, np.vstack(rows), altitudes)


Change = Callable[[RecordedData], RecordedData]


def ranges(column: int, change: Callable[[np.ndarray], np.ndarray], peer: int | None = None) -> Change:
    def changed(data: RecordedData) -> RecordedData:
        rows = data.ranges.copy()
        whose = np.ones(len(rows), dtype=bool) if peer is None else rows[:, 2] == peer
        rows[whose, column] = change(rows[whose, column])
        return replace(data, ranges=rows)

    return changed


def tracks(which: str, change: Callable[[PositionTrack], PositionTrack], vehicle: int | None = None) -> Change:
    def changed(data: RecordedData) -> RecordedData:
        before = getattr(data, which)
        return replace(data, **{which: {v: change(t) if vehicle in (None, v) else t for v, t in before.items()}})

    return changed


def everywhere(change: Callable[[PositionTrack], PositionTrack]) -> Change:
    return lambda data: tracks("truth", change)(tracks("reports", change)(data))


def positions(
    factor: float | tuple[float, float, float], axes: tuple[int, int, int] = (0, 1, 2)
) -> Callable[[PositionTrack], PositionTrack]:
    return lambda t: PositionTrack(t.times_s, t.positions_enu_m[:, axes] * factor, t.sigmas_m, t.velocities_enu_mps)


def velocities(factor: float, axes: tuple[int, int, int] = (0, 1, 2)) -> Callable[[PositionTrack], PositionTrack]:
    return lambda t: PositionTrack(t.times_s, t.positions_enu_m, t.sigmas_m, t.velocities_enu_mps[:, axes] * factor)


def times(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[PositionTrack], PositionTrack]:
    return lambda t: PositionTrack(change(t.times_s), t.positions_enu_m, t.sigmas_m, t.velocities_enu_mps)


def moved(t: PositionTrack) -> PositionTrack:
    return PositionTrack(t.times_s, t.positions_enu_m + 40.0, t.sigmas_m)


def heights(factor: float, more_m: float = 0.0) -> Change:
    def changed(data: RecordedData) -> RecordedData:
        rows = {v: np.column_stack((r[:, 0], factor * r[:, 1] + more_m, r[:, 2])) for v, r in data.heights.items()}
        return replace(data, heights=rows)

    return changed


def exchanged(peers: np.ndarray) -> np.ndarray:
    return np.where(peers < 3, 3 - peers, peers)


FOOT = 1.0 / 0.3048
SWAPPED = positions(1.0, (1, 0, 2))
WRONG = [
    ("ranges in millimetres", ranges(3, lambda r: 1000.0 * r), "range_factor", "ranges in mm, or the positions in km", 1000.0),
    ("ranges in centimetres", ranges(3, lambda r: 100.0 * r), "range_factor", "the ranges in cm?", 100.0),
    ("ranges in feet", ranges(3, lambda r: FOOT * r), "range_factor", "the ranges in ft?", FOOT),
    ("ranges in kilometres", ranges(3, lambda r: 0.001 * r), "range_factor", "the ranges in km?", 0.001),
    ("a factor of no unit", ranges(3, lambda r: 1.3 * r), "range_factor", "positions (gcs-coloc calibrate", 1.3),
    ("one device in millimetres", ranges(3, lambda r: 1000.0 * r, 2), "range_factor", "to and from UAV2", 1000.0),
    ("ranges with a delay in the antennas", ranges(3, lambda r: r + 30.0), "range_bias", "throughout (gcs-coloc calibrate", 30.0),
    ("ranges of two peers exchanged", ranges(2, exchanged), "range_residual", "1-UAV4, UAV2-", None),
    ("ranges stamped early", ranges(0, lambda t: t - 0.3), "time_offset", "0.30 s ahead", 0.3),
    ("ranges by another clock", ranges(0, lambda t: t + 18.0), "time_offset", "18.00 s behind", -18.0),
    ("ranges in milliseconds", ranges(0, lambda t: 1000.0 * t), "slow_ranges", "milliseconds", 200.0),
    ("ranges since 1970", ranges(0, lambda t: t + 1.7e9), "no_overlap", "one clock", None),
    ("a peer by another clock", tracks("reports", times(lambda t: t + 2.0), 1), "time_offset", "of the positions of UAV1", 2.0),
    ("a peer with swapped axes", tracks("reports", SWAPPED, 2), "position_axes", "swapped in the positions of UAV2", None),
    ("reports in feet", tracks("reports", positions(FOOT)), "truth_factor", "reports in ft", 0.3048),
    ("all positions in feet", everywhere(positions(FOOT)), "range_factor", "positions in ft", 0.3048),
    ("heights of reports in feet", tracks("reports", positions((1.0, 1.0, FOOT))), "truth_height_factor", "ones in ft", None),
    ("velocities in cm/s", tracks("reports", velocities(100.0)), "velocity_factor", "velocities in cm/s", 100.0),
    ("velocities north first", tracks("reports", velocities(1.0, (1, 0, 2))), "velocity_axes", "swapped", None),
    ("velocities backwards", tracks("reports", velocities(-1.0)), "velocity_sign", "opposite sign", None),
    ("velocities of something else", tracks("reports", velocities(0.0)), "velocity_residual", "off the rate of change", None),
    ("truth in millimetres", tracks("truth", positions(1000.0)), "truth_factor", "truth in mm", 1000.0),
    ("truth with swapped axes", tracks("truth", SWAPPED), "truth_axes", "swapped", None),
    ("truth north, east, down", tracks("truth", positions((1.0, 1.0, -1.0), (1, 0, 2))), "truth_axes", "north, east, down", None),
    ("truth with heights in feet", tracks("truth", positions((1.0, 1.0, FOOT))), "truth_height_factor", "truth in ft", None),
    ("truth about another origin", tracks("truth", moved), "truth_offset", "(40.", None),
    ("truth by another clock", tracks("truth", times(lambda t: t + 1.0)), "time_offset", "truth of UAV4 is 1.00 s ahead", 1.0),
    ("truth in milliseconds", tracks("truth", times(lambda t: 1000.0 * t)), "no_overlap", "of the truth", None),
    ("heights in feet", heights(FOOT), "height_factor", "heights in ft", FOOT),
    ("heights downwards", heights(-1.0), "height_sign", "downwards", None),
    ("heights above another datum", heights(1.0, 48.0), "height_offset", "+4", 48.0),
]  # fmt: skip


@pytest.mark.parametrize(("change", "kind", "words", "value"), [w[1:] for w in WRONG], ids=[w[0] for w in WRONG])
def test_an_error_in_the_data_is_the_first_finding_in_one_line_with_the_number(change, kind, words, value):
    first, *more = run_checks(change(fleet(1)))
    assert first.kind == kind
    assert "\n" not in first.text
    assert words in first.text
    if value is not None:
        assert first.value == pytest.approx(value, rel=0.02)
    assert len({finding.text for finding in (first, *more)}) == 1 + len(more) <= 4


def test_sound_data_have_no_findings():
    """Fifty fleets: one false alarm would be a rate above what a warning is worth."""
    assert [run_checks(fleet(seed)) for seed in range(50)] == [[]] * 50


def test_a_tenth_of_the_ranges_far_too_long_and_a_small_bias_are_no_other_unit():
    """Multipath and antenna delays are what estimators are for."""
    data = fleet(3)
    rng = np.random.default_rng(3)
    rows = data.ranges.copy()
    rows[:, 3] += 1.0 + np.where(rng.random(len(rows)) < 0.1, rng.uniform(5.0, 200.0, len(rows)), 0.0)
    assert run_checks(replace(data, ranges=rows)) == []


def test_a_pair_behind_obstacles_has_no_clock_of_its_own_where_both_ends_fit_their_other_ranges():
    """The distances of another time may fit them: 8 s later in this case."""
    truth = fleet(2).truth[DENIED]
    places = {1: (2500.0, 500.0, 145.0), 2: (700.0, 2500.0, 145.0), 3: (700.0, -1500.0, 145.0)}
    anchors = {v: PositionTrack(np.zeros(1), np.array([at]), np.full(1, 0.01), is_static=True) for v, at in places.items()}
    rows = []
    for tag, anchor, late_s in ((DENIED, 1, 8.0), (DENIED, 2, 0.0), (DENIED, 3, 0.0), (5, 1, 0.0), (5, 2, 0.0)):
        t = np.arange(1.0, END_S - 10.0, 0.5)
        distance_m = np.linalg.norm(path(DENIED, t + late_s)[0] - places[anchor], axis=1)
        rows.append(np.column_stack((t, np.full((len(t), 2), (tag, anchor)), distance_m, np.full(len(t), SIGMA_RANGE_M))))
    names = {v: f"UAV{v}" for v in range(1, 6)}
    (found,) = run_checks(RecordedData(names, anchors, {DENIED: truth, 5: truth}, np.vstack(rows)))
    assert found.kind is FindingKind.RANGE_RESIDUAL
    assert "UAV1-UAV4 differ" in found.text


def test_a_fleet_in_formation_has_no_clock_to_compare_but_a_unit():
    """Distances that never change tell nothing of time; a bias and a factor cannot be told apart but by the unit's name."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.2)
    way = np.column_stack((20.0 * t, 0.0 * t, np.full(len(t), 100.0)))
    places = {1: (0.0, 0.0, 0.0), 2: (80.0, 60.0, 0.0)}
    reports = {
        v: position_track(np.column_stack((t, way + place + rng.normal(0.0, 0.5, way.shape), np.full(len(t), 0.5))))
        for v, place in places.items()
    }
    rows = np.column_stack((t, np.full((len(t), 2), (1, 2)), 100.0 + rng.normal(0.0, 0.1, len(t)), np.full(len(t), 0.1)))
    data = RecordedData({1: "1", 2: "2"}, reports, {}, rows)
    assert run_checks(data) == []
    rows[:, 3] *= 1000.0
    (finding,) = run_checks(data)
    assert (finding.kind, finding.value) == ("range_factor", pytest.approx(1000.0, rel=0.01))


def walk_among_anchors(off_m: tuple[float, float, float]) -> RecordedData:
    """A walk among three anchors, the ranges to each of which are off."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 60.0, 0.1)
    walk = np.column_stack((10.0 + 0.3 * t, 5.0 + 8.0 * np.sin(t / 9.0), np.full(len(t), 1.0)))
    places = {2: (0.0, 0.0, 2.0), 3: (40.0, 3.0, 3.0), 4: (5.0, 30.0, 1.0)}
    rows = []
    for (v, p), off in zip(places.items(), off_m, strict=True):
        range_m = np.linalg.norm(walk - p, axis=1) + off + rng.normal(0.0, 0.1, len(t))
        rows.append(np.column_stack((t, np.full((len(t), 2), (1, v)), range_m, np.full(len(t), 0.1))))
    anchors = {v: PositionTrack(np.zeros(1), np.array([p]), np.array([0.02]), is_static=True) for v, p in places.items()}
    names = {v: f"A{v}" for v in range(1, 5)}
    return RecordedData(names, anchors, {1: PositionTrack(t, walk, np.zeros(len(t)))}, np.vstack(rows))


def test_beside_one_device_that_is_far_off_the_others_are_told_too():
    """One radio was named, and that all are off by two sigmas was not."""
    far, mean = run_checks(walk_among_anchors((1.0, 0.2, 0.2)))
    assert (far.kind, mean.kind) == ("range_bias", "range_mean")
    assert "A2" in far.text
    assert mean.value == pytest.approx(0.2, abs=0.03)
    assert "A1-A3, A1-A4" in mean.text


def test_millimetres_are_told_in_a_room_where_a_bias_is_a_share_of_the_distances():
    """They were "1065 times the distances", which calibrate was to estimate."""
    data = walk_among_anchors((1.2, 1.2, 1.2))
    rows = data.ranges.copy()
    rows[:, 3] *= 1000.0
    (finding, *_) = run_checks(replace(data, ranges=rows))
    assert (finding.kind, finding.value) == ("range_factor", pytest.approx(1060.0, abs=35.0))
    assert "are the ranges in mm" in finding.text


def test_ranges_that_are_off_to_both_sides_are_not_told_to_be_right_in_the_mean():
    (finding,) = run_checks(walk_among_anchors((0.2, -0.25, 0.0)))
    assert (finding.kind, finding.value) == ("range_mean", pytest.approx(-0.25, abs=0.03))


def test_the_positions_of_anchors_are_compared_with_the_ranges():
    data = walk_among_anchors((0.0, 0.0, 0.0))
    anchors = data.reports
    assert run_checks(data) == []
    swapped = {
        v: PositionTrack(a.times_s, a.positions_enu_m[:, (1, 0, 2)], a.sigmas_m, is_static=True) for v, a in anchors.items()
    }
    (finding,) = run_checks(replace(data, reports=swapped))
    assert finding.kind == "position_axes"
    assert "east and north are swapped" in finding.text


def test_repeated_ranges_are_counted_in_either_direction():
    data = fleet(1)
    back = data.ranges[:7][:, (0, 2, 1, 3, 4)]
    (finding,) = run_checks(replace(data, ranges=np.vstack((data.ranges, data.ranges[:5], back))))
    assert (finding.kind, finding.value) == ("repeated_ranges", 12)


def test_arrivals_by_another_clock_are_a_finding():
    found = list(check_delays({"ranges": np.full(30, 1.7e9), "positions": np.full(30, 0.4), "heights": np.zeros(0)}))
    assert [finding.kind for finding in found] == ["late_arrival"]
    assert found[0].text.startswith("ranges arrive 1.7e+09 s after they were measured")


@pytest.mark.parametrize("rows", [0, 1, 5])
def test_a_recording_with_few_rows_is_not_checked(rows):
    data = fleet(1)
    few = replace(data, ranges=1000.0 * data.ranges[:rows], heights={v: r[:rows] for v, r in data.heights.items()})
    assert [d for d in run_checks(few) if d.kind.startswith(("range", "height"))] == []


def test_three_tags_on_one_body_are_no_repeated_ranges():
    """Of three values of one time, in steps of a centimetre, some are the same by chance; of a doubled table all."""
    rng = np.random.default_rng(1)
    times = np.repeat(np.arange(200.0), 3)
    values = np.round(5.0 + 0.03 * rng.standard_normal(600), 2)
    rows = np.column_stack((times, np.full(600, 1.0), np.full(600, 2.0), values, np.full(600, 0.1)))
    tags = RecordedData(names={1: "a", 2: "b"}, reports={}, truth={}, ranges=rows)
    assert "repeated_ranges" not in {finding.kind for finding in run_checks(tags)}
    doubled = replace(tags, ranges=np.vstack((rows, rows)))
    assert "repeated_ranges" in {finding.kind for finding in run_checks(doubled)}


def test_a_radio_that_repeats_its_last_range_is_told():
    def stuck(data: RecordedData) -> RecordedData:
        rows = data.ranges.copy()
        of_peer = (rows[:, 2] == 2) & (rows[:, 0] > 80.0) & (rows[:, 0] < 100.05)
        rows[of_peer, 3] = rows[of_peer, 3][0]
        return replace(data, ranges=rows)

    assert "stuck_ranges" not in {found.kind for found in run_checks(fleet(1))}
    (finding,) = [found for found in run_checks(stuck(fleet(1))) if found.kind == "stuck_ranges"]
    assert finding.value == pytest.approx(19.8, abs=0.3)
    assert "UAV2-UAV4" in finding.text


def test_a_vehicle_that_stands_still_beside_coarse_radios_has_no_stuck_ranges():
    data = fleet(1)
    rows = data.ranges[(data.ranges[:, 0] > 80.0)].copy()
    rows[:, 3] = np.round(rows[:, 2] * 100.0)
    assert "stuck_ranges" not in {found.kind for found in run_checks(replace(data, ranges=rows))}
