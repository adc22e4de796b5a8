"""All data checks of a recording: clocks, truth, ranges, heights, velocities and repeated ranges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.findings import (
    DataFinding,
    Explanation,
    FindingKind,
    choose,
    clock_finding,
    finding,
    join_vehicles,
    median_ratio,
    median_residual_m,
    unit_question,
)
from gcs_coloc.evaluation.data_checks.range_checks import check_ranges
from gcs_coloc.evaluation.data_checks.recorded_data import PositionTrack, RecordedData, find_time_offset_s, thinned

_SLOW_S = 20.0
"""Median time between two ranges of a pair above which times can hardly be seconds; chosen: radios range every 0.01 to 5 s."""
_LATE_S = 10.0
"""Median delay of arrival above which it can hardly be by one clock; chosen: telemetry radios buffer up to some seconds."""
_APART_S = 60.0
"""Positions so long before the first range or after the last one still count as of their time; chosen: a vehicle's start-up."""
_LEAST_OVERLAP = 0.02
"""Share of the positions that must be of the time of the ranges; chosen: a flight of an hour ranged for two minutes."""
_LEAST_ROWS = 20
"""Values that a vehicle needs to be checked; chosen: a median of fewer moves with single outliers."""
_MOST_ROWS = 1000
"""Values of a vehicle that are compared, evenly spaced; chosen: the search for a clock offset takes below a second."""
_SUSPECT_SIGMAS = 5.0
"""Median residual, in stated sigmas, that is a finding; chosen: receivers state 2 to 3 times too little under multipath."""
_REPEATED_SHARE = 0.5
"""Share of a pair's ranges of one time that are the same, from which they are repeats; chosen: of three tags with steps of a
centimetre and a noise of 3 cm some 20 % are, of a table that was written twice all."""
_STUCK_S = 10.0
_STUCK_ROWS = 20
"""A range repeats one value for so long and so often before it is told; chosen: a vehicle that stands still has other noise."""
_CHANGE_SHARE = 0.5
"""Share of another pair's ranges that differ from the one before, from which the vehicle is known to be measured anew; chosen:
radios with steps of a tenth of their noise repeat 3 %, a table with twice as many rows as measurements 50 %."""
_FOOT_M = 0.3048
"""ISO 31-1."""
_FAR_SIGMAS = 100.0
_MOST_STEPS = 64
"""Velocities are integrated over displacements of 100 position sigmas, 64 reports at most; chosen: noise makes 1 % of those."""
_SPEED_SHARE = 0.1
_SPEED_MPS = 0.5
"""A velocity may be off by 10 % and 0.5 m/s; chosen: receivers filter it, and reports are rounded."""

_AXES = (
    ((1, 0, 2), (1.0, 1.0, 1.0), "east and north are swapped"),
    ((0, 1, 2), (1.0, 1.0, -1.0), "heights count downwards"),
    ((1, 0, 2), (1.0, 1.0, -1.0), "the axes are north, east, down"),
)
"""Frames that are mistaken for east, north, up: the order of the axes, their signs, and the words."""


def run_checks(data: RecordedData) -> list[DataFinding]:
    """Return all findings, the most basic first.

    The checks correct nothing: an estimator gets the data as they are.
    """
    truth = list(join_vehicles(_truth_findings(data)))
    return [
        *_check_clocks(data),
        *truth,
        # A truth that contradicts the reports is no witness against the ranges.
        *check_ranges(data, trust_truth=not truth),
        *join_vehicles(_height_findings(data)),
        *join_vehicles(_velocity_findings(data)),
        *_check_repeats(data),
        *_check_stuck(data),
    ]


def check_delays(delays_s: Mapping[str, FloatArray]) -> Iterator[DataFinding]:
    """Yield kinds of measurements that arrive too late for one clock.

    Delays (N,) are in s, by the kind's name.
    """
    for name, delays in delays_s.items():
        if len(delays) and (delay_s := float(np.median(delays))) > _LATE_S:
            yield finding(FindingKind.LATE_ARRIVAL, delay_s, name)


def _check_clocks(data: RecordedData) -> Iterator[DataFinding]:
    """Yield findings on tracks at other times than the ranges, and on times that are hardly seconds."""
    ranges_s = data.ranges[:, 0]
    if len(ranges_s) == 0:
        return
    for name, tracks in (("reported positions", data.reports), ("truth", data.truth)):
        times = [track.times_s for track in tracks.values() if not track.is_static]
        if not times:
            continue
        times_s = np.concatenate(times)
        near = float(((times_s >= ranges_s.min() - _APART_S) & (times_s <= ranges_s.max() + _APART_S)).mean())
        if near < _LEAST_OVERLAP:
            yield finding(FindingKind.NO_OVERLAP, near, name, span=_span(times_s), range_span=_span(ranges_s))
    a, b = np.sort(data.ranges[:, 1:3], axis=1).T
    order = np.lexsort((ranges_s, b, a))
    same_pair = (np.diff(a[order]) == 0) & (np.diff(b[order]) == 0)
    spacings_s = np.diff(ranges_s[order])[same_pair]
    if len(spacings_s) and (spacing_s := float(np.median(spacings_s))) > _SLOW_S:
        yield finding(FindingKind.SLOW_RANGES, spacing_s)


def _span(times_s: FloatArray) -> str:
    return f"{times_s.min():.10g} to {times_s.max():.10g} s"


def _check_repeats(data: RecordedData) -> Iterator[DataFinding]:
    """Yield how many ranges repeat time, vehicles (in either direction) and value of another one.

    Several tags on one body range at one time as well: of their values only some are the same, by the radio's resolution.
    """
    pair = np.sort(data.ranges[:, 1:3], axis=1)
    keys = np.column_stack((data.ranges[:, 0], pair, data.ranges[:, 3]))
    keys = keys[np.lexsort(keys.T[::-1])]
    at_one_time = int((keys[1:, :3] == keys[:-1, :3]).all(axis=1).sum())
    count = int((keys[1:] == keys[:-1]).all(axis=1).sum())
    if count > _REPEATED_SHARE * at_one_time:
        yield finding(FindingKind.REPEATED_RANGES, count)


def _check_stuck(data: RecordedData) -> Iterator[DataFinding]:
    """Yield the pairs whose ranges repeat one value, where those of another pair of the vehicle change."""
    ends = np.sort(data.ranges[:, 1:3], axis=1).astype(int)
    pairs: dict[tuple[int, int], FloatArray] = {}
    for a, b in np.unique(ends, axis=0).tolist():
        rows = data.ranges[(ends == (a, b)).all(axis=1)][:, (0, 3)]
        pairs[a, b] = rows[np.argsort(rows[:, 0], kind="stable")]
    for pair, rows in pairs.items():
        begins = np.flatnonzero(np.concatenate(([True], rows[1:, 1] != rows[:-1, 1])))
        ends_at = np.concatenate((begins[1:], [len(rows)])) - 1
        long = int(np.argmax(ends_at - begins))
        first, last = int(begins[long]), int(ends_at[long])
        from_s, until_s = rows[first, 0], rows[last, 0]
        if last - first < _STUCK_ROWS or until_s - from_s < _STUCK_S:
            continue
        beside = [
            other[(other[:, 0] >= from_s) & (other[:, 0] <= until_s), 1]
            for key, other in pairs.items()
            if key != pair and set(key) & set(pair)
        ]
        if any(len(each) > _STUCK_ROWS and float((np.diff(each) != 0.0).mean()) >= _CHANGE_SHARE for each in beside):
            who = f"the ranges {data.names[pair[0]]}-{data.names[pair[1]]}"
            yield finding(FindingKind.STUCK_RANGES, until_s - from_s, who, range_m=rows[first, 1])


def _truth_findings(data: RecordedData) -> Iterator[tuple[str, DataFinding]]:
    """Yield how the truth differs from what vehicles report, where that is more than they state."""
    for vehicle, truth in data.truth.items():
        reports = data.reports.get(vehicle)
        if reports is None or reports.is_static:
            continue
        rows = np.column_stack((reports.times_s, reports.positions_enu_m, reports.sigmas_m))
        rows = thinned(rows[truth.at(reports.times_s)[1]], _MOST_ROWS)
        if len(rows) < _LEAST_ROWS:
            continue
        times_s, reported, sigma_m = rows[:, 0], rows[:, 1:4], float(np.median(rows[:, 4]))
        residual_m = median_residual_m(np.linalg.norm(truth.at(times_s)[0] - reported, axis=1))
        if residual_m > _SUSPECT_SIGMAS * sigma_m:
            explanations = _truth_explanations(truth, sigma_m, times_s, reported, residual_m, data.origin_height_m)
            unexplained = finding(FindingKind.TRUTH_RESIDUAL, residual_m, sigma_m=sigma_m)
            yield data.names[vehicle], choose(explanations, residual_m, sigma_m) or unexplained


def _truth_explanations(
    truth: PositionTrack, sigma_m: float, times_s: FloatArray, reported: FloatArray, residual_m: float, origin_height_m: float
) -> Iterator[Explanation]:
    true = truth.at(times_s)[0]
    yield from _factor_explanations(true, reported, FindingKind.TRUTH_FACTOR, "the truth in {}", "the reports in {}")
    yield from _axes_explanations(true, reported, FindingKind.TRUTH_AXES)
    for factor in (1.0 / _FOOT_M, _FOOT_M):
        scaled = true.copy()
        scaled[:, 2] = (true[:, 2] + origin_height_m) / factor - origin_height_m
        question = unit_question(factor, "those of the truth in {}", "the reported ones in {}")
        yield Explanation(_left_m(scaled, reported), finding(FindingKind.TRUTH_HEIGHT_FACTOR, factor, question=question))

    def shifted(by_s: float) -> FloatArray:
        positions, known = truth.at(times_s + by_s)
        return np.where(known, np.linalg.norm(positions - reported, axis=1), np.nan)

    offset_s, after_m = find_time_offset_s(shifted)
    yield Explanation(after_m, clock_finding("the truth of {who}", "the reports", offset_s, residual_m, after_m))
    apart = np.median(true - reported, axis=0)
    # An offset of any size fits by chance more easily: it must explain all of the residual.
    left_m = _left_m(true - apart, reported)
    if left_m <= _SUSPECT_SIGMAS * sigma_m:
        vector = "(" + ", ".join(f"{x:.1f}" for x in apart) + ")"
        yield Explanation(left_m, finding(FindingKind.TRUTH_OFFSET, float(np.linalg.norm(apart)), offset=vector))


def _height_findings(data: RecordedData) -> Iterator[tuple[str, DataFinding]]:
    """Yield how reported heights differ from those of the positions, or of the truth where there are none."""
    for vehicle, heights in data.heights.items():
        for tracks, of in ((data.reports, "positions"), (data.truth, "truth")):
            if vehicle not in tracks:
                continue
            positions, known = tracks[vehicle].at(heights[:, 0])
            if known.sum() < _LEAST_ROWS:
                continue
            reported_m, up_m = heights[known, 1], positions[known, 2]
            sigma_m = float(np.hypot(np.median(heights[known, 2]), np.median(tracks[vehicle].sigmas_m)))
            residual_m = median_residual_m(reported_m - up_m)
            if residual_m > _SUSPECT_SIGMAS * sigma_m:
                unexplained = finding(FindingKind.HEIGHT_RESIDUAL, residual_m, of=of, sigma_m=sigma_m)
                yield data.names[vehicle], choose(_height_explanations(of, reported_m, up_m), residual_m, sigma_m) or unexplained
            break


def _height_explanations(of: str, reported_m: FloatArray, up_m: FloatArray) -> Iterator[Explanation]:
    factor = median_ratio(reported_m, up_m)
    if factor < 0.0:
        yield Explanation(median_residual_m(-reported_m - up_m), finding(FindingKind.HEIGHT_SIGN, of=of))
    elif question := unit_question(factor, "the heights in {}", f"those of the {of} in {{}}"):
        left_m = median_residual_m(reported_m / factor - up_m)
        yield Explanation(left_m, finding(FindingKind.HEIGHT_FACTOR, factor, of=of, question=question))
    offset_m = float(np.median(reported_m - up_m))
    yield Explanation(median_residual_m(reported_m - offset_m - up_m), finding(FindingKind.HEIGHT_OFFSET, offset_m, of=of))


def _velocity_findings(data: RecordedData) -> Iterator[tuple[str, DataFinding]]:
    """Yield how velocities differ from the rate of change of the positions that come with them."""
    for vehicle, reports in data.reports.items():
        displacements = _displacements(reports)
        if displacements is None:
            continue
        moved_m, integrated_m, span_s = displacements
        sigma_m = float(np.median(reports.sigmas_m))
        residual_m = median_residual_m(np.linalg.norm(integrated_m - moved_m, axis=1))
        length_m = float(np.median(np.linalg.norm(moved_m, axis=1)))
        if residual_m > 2.0 * _SUSPECT_SIGMAS * sigma_m + _SPEED_SHARE * length_m + _SPEED_MPS * span_s:
            unexplained = finding(FindingKind.VELOCITY_RESIDUAL, residual_m / span_s)
            yield data.names[vehicle], choose(_velocity_explanations(integrated_m, moved_m), residual_m, sigma_m) or unexplained


def _displacements(reports: PositionTrack) -> tuple[FloatArray, FloatArray, float] | None:
    """Return displacements (N, 3), m, by positions and by velocities, and the median time of one, s."""
    velocities = reports.velocities_enu_mps
    if reports.is_static or velocities is None or np.isnan(velocities).any() or len(velocities) < _LEAST_ROWS:
        return None
    steps = np.diff(reports.times_s)[:, np.newaxis] * 0.5 * (velocities[1:] + velocities[:-1])
    integral = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))
    spacing_s, positions = float(np.median(np.diff(reports.times_s))), reports.positions_enu_m
    far_m = _FAR_SIGMAS * float(np.median(reports.sigmas_m))
    ahead = 1
    while (
        ahead < _MOST_STEPS
        and len(integral) > 2 * ahead + _LEAST_ROWS
        and np.median(np.linalg.norm(positions[ahead:] - positions[:-ahead], axis=1)) < far_m
    ):
        ahead *= 2
    if len(integral) < ahead + _LEAST_ROWS:
        return None
    spans_s = reports.times_s[ahead:] - reports.times_s[:-ahead]
    whole = (spans_s > 0.0) & (spans_s < 2.0 * ahead * spacing_s)
    moved, integrated = (positions[ahead:] - positions[:-ahead])[whole], (integral[ahead:] - integral[:-ahead])[whole]
    return (moved, integrated, float(np.median(spans_s[whole]))) if len(moved) >= _LEAST_ROWS else None


def _velocity_explanations(integrated_m: FloatArray, moved_m: FloatArray) -> Iterator[Explanation]:
    kind, velocities, positions = FindingKind.VELOCITY_FACTOR, "the velocities in {}/s", "the positions in {}"
    yield from _factor_explanations(integrated_m, moved_m, kind, velocities, positions)
    yield from _axes_explanations(integrated_m, moved_m, FindingKind.VELOCITY_AXES)
    yield Explanation(_left_m(-integrated_m, moved_m), finding(FindingKind.VELOCITY_SIGN))


def _left_m(vectors_m: FloatArray, reference_m: FloatArray) -> float:
    """Return the median distance between vectors (N, 3) and their references (N, 3), m."""
    return median_residual_m(np.linalg.norm(vectors_m - reference_m, axis=1))


def _factor_explanations(
    vectors_m: FloatArray, reference_m: FloatArray, kind: FindingKind, of: str, than: str
) -> Iterator[Explanation]:
    """Yield that vectors (N, 3) are in another unit than the reference, where lengths look like it."""
    factor = median_ratio(np.linalg.norm(vectors_m, axis=1), np.linalg.norm(reference_m, axis=1))
    question = unit_question(factor, of, than)
    if question:
        yield Explanation(_left_m(vectors_m / factor, reference_m), finding(kind, factor, question=question))


def _axes_explanations(vectors_m: FloatArray, reference_m: FloatArray, kind: FindingKind) -> Iterator[Explanation]:
    """Yield that vectors (N, 3) are in each of the frames that are mistaken for east, north, up."""
    for axes, signs, words in _AXES:
        yield Explanation(_left_m(vectors_m[:, axes] * signs, reference_m), finding(kind, axes=words))
