"""Reported positions, heights and velocities held against the truth and against each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.evidence import Evidence, thinned
from gcs_coloc.evaluation.data_checks.finding import DataFinding, length_unit, speed_unit, told_together
from gcs_coloc.evaluation.data_checks.readings import Reading, good, median_misfit_m, time_offset_s
from gcs_coloc.evaluation.data_checks.tracks import PositionTrack

_LEAST_ROWS = 20
_MOST_ROWS = 1000
_DOUBTFUL_SIGMAS = 5.0
_FOOT_M = 0.3048
_FAR_SIGMAS = 100.0
_MOST_STEPS = 64
_SPEED_SHARE = 0.1
_SPEED_MPS = 0.5

_FRAMES = (
    ((1, 0, 2), (1.0, 1.0, 1.0), "east and north are swapped"),
    ((0, 1, 2), (1.0, 1.0, -1.0), "heights count downwards"),
    ((1, 0, 2), (1.0, 1.0, -1.0), "the axes are north, east, down"),
)


def check_truth(evidence: Evidence) -> Iterator[DataFinding]:
    """Yield how the truth differs from what vehicles report, where that is more than they state."""
    return told_together(_truth_doubts(evidence))


def _truth_doubts(evidence: Evidence) -> Iterator[tuple[str, list[DataFinding]]]:
    for vehicle, truth in evidence.truth.items():
        reports = evidence.reports.get(vehicle)
        if reports is None or reports.is_static:
            continue
        rows = _comparable(reports, truth)
        if len(rows) < _LEAST_ROWS:
            continue
        times_s, reported, sigma_m = rows[:, 0], rows[:, 1:4], float(np.median(rows[:, 4]))
        true = truth.at(times_s)[0]
        misfit_m = median_misfit_m(np.linalg.norm(true - reported, axis=1))
        if misfit_m <= _DOUBTFUL_SIGMAS * sigma_m:
            continue
        text = f"the truth of {{who}} is {misfit_m:.3g} m off what is reported in the median, where {sigma_m:.3g} m are stated"
        found = good(_truth_readings(truth, sigma_m, times_s, true, reported, evidence.origin_height_m), misfit_m, sigma_m)
        yield evidence.names[vehicle], found or [DataFinding("truth_misfit", text, misfit_m)]


def _comparable(reports: PositionTrack, truth: PositionTrack) -> FloatArray:
    rows = np.column_stack((reports.times_s, reports.positions_enu_m, reports.sigmas_m))
    return thinned(rows[truth.at(reports.times_s)[1]], _MOST_ROWS)


def _truth_readings(
    truth: PositionTrack, sigma_m: float, times_s: FloatArray, true: FloatArray, reported: FloatArray, origin_height_m: float
) -> Iterator[Reading]:
    lengths = np.linalg.norm(reported, axis=1)
    factor = _median_ratio(np.linalg.norm(true, axis=1), lengths)
    unit = length_unit(max(factor, 1.0 / factor)) if factor > 0.0 else ""
    if unit:
        which = "truth" if factor > 1.0 else "reports"
        left_m = median_misfit_m(np.linalg.norm(true / factor - reported, axis=1))
        text = f"the truth of {{who}} is {factor:.4g} times what is reported: {which} {unit}?"
        yield Reading(left_m, DataFinding("truth_factor", text, factor))
    for axes, signs, what in _FRAMES:
        left_m = median_misfit_m(np.linalg.norm(true[:, axes] * signs - reported, axis=1))
        text = f"the truth of {{who}} fits what is reported if in one of the two {what}"
        yield Reading(left_m, DataFinding("truth_axes", text))
    for which, in_feet, in_metres in (("truth", true, reported), ("reports", reported, true)):
        mended = in_feet.copy()
        mended[:, 2] = (in_feet[:, 2] + origin_height_m) * _FOOT_M - origin_height_m
        left_m = median_misfit_m(np.linalg.norm(mended - in_metres, axis=1))
        text = f"the truth of {{who}} fits what is reported if in the {which} heights are in feet"
        yield Reading(left_m, DataFinding(f"{which}_feet", text))

    def later(later_s: float) -> FloatArray:
        where, known = truth.at(times_s + later_s)
        return np.where(known, np.linalg.norm(where - reported, axis=1), np.nan)

    offset_s, left_m = time_offset_s(later)
    which = "later" if offset_s < 0.0 else "earlier"
    yield Reading(
        left_m,
        DataFinding(
            "time_offset", f"the truth of {{who}} fits what is reported if it is stamped {abs(offset_s):.2f} s {which}", offset_s
        ),
    )
    apart = np.median(true - reported, axis=0)
    left_m = median_misfit_m(np.linalg.norm(true - apart - reported, axis=1))
    # A number that may be any is believed only where it explains all.
    if left_m <= _DOUBTFUL_SIGMAS * sigma_m:
        yield Reading(
            left_m,
            DataFinding(
                "truth_offset",
                f"the truth of {{who}} lies {_vector(apart)} (east, north, up) off what is reported throughout",
                float(np.linalg.norm(apart)),
            ),
        )


def check_heights(evidence: Evidence) -> Iterator[DataFinding]:
    """Yield how reported heights differ from those of the positions, or of the truth where there are none."""
    return told_together(_height_doubts(evidence))


def _height_doubts(evidence: Evidence) -> Iterator[tuple[str, list[DataFinding]]]:
    for vehicle, heights in evidence.altitudes.items():
        for tracks, of_what in ((evidence.reports, "positions"), (evidence.truth, "truth")):
            if vehicle not in tracks:
                continue
            where, known = tracks[vehicle].at(heights[:, 0])
            if known.sum() < _LEAST_ROWS:
                continue
            told, up_m = heights[known, 1], where[known, 2]
            sigma_m = float(np.hypot(np.median(heights[known, 2]), np.median(tracks[vehicle].sigmas_m)))
            misfit_m = median_misfit_m(np.abs(told - up_m))
            if misfit_m > _DOUBTFUL_SIGMAS * sigma_m:
                text = f"the heights of {{who}} are {misfit_m:.3g} m off the {of_what} in the median, {sigma_m:.3g} m are stated"
                found = good(_height_readings(of_what, told, up_m), misfit_m, sigma_m)
                yield evidence.names[vehicle], found or [DataFinding("height_misfit", text, misfit_m)]
            break


def _height_readings(of_what: str, told: FloatArray, up_m: FloatArray) -> Iterator[Reading]:
    factor = _median_ratio(told, up_m)
    if factor < 0.0:
        yield Reading(
            median_misfit_m(np.abs(-told - up_m)),
            DataFinding(
                "height_sign", f"the heights of {{who}} have the opposite sign of the {of_what}: do they count downwards?"
            ),
        )
    elif factor > 0.0 and (unit := length_unit(factor)):
        left_m = median_misfit_m(np.abs(told / factor - up_m))
        yield Reading(
            left_m,
            DataFinding(
                "height_factor", f"the heights of {{who}} are {factor:.4g} times those of the {of_what}: {unit}?", factor
            ),
        )
    offset_m = float(np.median(told - up_m))
    yield Reading(
        median_misfit_m(np.abs(told - offset_m - up_m)),
        DataFinding("height_offset", f"the heights of {{who}} are {offset_m:+.4g} m off the {of_what} throughout", offset_m),
    )


def check_velocities(evidence: Evidence) -> Iterator[DataFinding]:
    """Yield how velocities differ from how the positions that come with them change."""
    return told_together(_velocity_doubts(evidence))


def _velocity_doubts(evidence: Evidence) -> Iterator[tuple[str, list[DataFinding]]]:
    for vehicle, reports in evidence.reports.items():
        moved = _moves(reports)
        if moved is None:
            continue
        apart, told, elapsed_s = moved
        misfit_m = median_misfit_m(np.linalg.norm(told - apart, axis=1))
        way_m = float(np.median(np.linalg.norm(apart, axis=1)))
        allowed_m = 2.0 * _DOUBTFUL_SIGMAS * float(np.median(reports.sigmas_m)) + _SPEED_SHARE * way_m + _SPEED_MPS * elapsed_s
        if misfit_m > allowed_m:
            text = f"the velocities of {{who}} are {misfit_m / elapsed_s:.3g} m/s off how the positions change, in the median"
            found = good(_velocity_readings(told, apart), misfit_m, float(np.median(reports.sigmas_m)))
            yield evidence.names[vehicle], found or [DataFinding("velocity_misfit", text, misfit_m)]


def _moves(reports: PositionTrack) -> tuple[FloatArray, FloatArray, float] | None:
    """How far a vehicle came (N, 3) by its positions and by its velocities, m, in spans of so many seconds in the median."""
    velocities = reports.velocities_enu_mps
    if reports.is_static or velocities is None or np.isnan(velocities).any() or len(velocities) < _LEAST_ROWS:
        return None
    steps = np.diff(reports.times_s)[:, np.newaxis] * 0.5 * (velocities[1:] + velocities[:-1])
    way = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))
    spacing_s, positions = float(np.median(np.diff(reports.times_s))), reports.positions_enu_m
    ahead = 1
    # Far enough for the noise of the positions not to matter, if it is anywhere.
    while (
        ahead < _MOST_STEPS
        and len(way) > 2 * ahead + _LEAST_ROWS
        and (
            np.median(np.linalg.norm(positions[ahead:] - positions[:-ahead], axis=1)) < _FAR_SIGMAS * np.median(reports.sigmas_m)
        )
    ):
        ahead *= 2
    if len(way) < ahead + _LEAST_ROWS:
        return None
    spans_s = reports.times_s[ahead:] - reports.times_s[:-ahead]
    whole = (spans_s > 0.0) & (spans_s < 2.0 * ahead * spacing_s)
    apart, told = (positions[ahead:] - positions[:-ahead])[whole], (way[ahead:] - way[:-ahead])[whole]
    return (apart, told, float(np.median(spans_s[whole]))) if len(apart) >= _LEAST_ROWS else None


def _velocity_readings(told: FloatArray, apart: FloatArray) -> Iterator[Reading]:
    factor = _median_ratio(np.linalg.norm(told, axis=1), np.linalg.norm(apart, axis=1))
    if factor > 0.0 and (unit := speed_unit(factor)):
        left_m = median_misfit_m(np.linalg.norm(told / factor - apart, axis=1))
        yield Reading(
            left_m,
            DataFinding(
                "velocity_factor",
                f"the velocities of {{who}} are {factor:.3g} times how fast the positions change: {unit}?",
                round(factor, 6),
            ),
        )
    for axes, signs, what in _FRAMES:
        left_m = median_misfit_m(np.linalg.norm(told[:, axes] * signs - apart, axis=1))
        text = f"the velocities of {{who}} fit how the positions change if in them {what}"
        yield Reading(left_m, DataFinding("velocity_axes", text))
    left_m = median_misfit_m(np.linalg.norm(-told - apart, axis=1))
    yield Reading(
        left_m, DataFinding("velocity_sign", "the velocities of {who} have the opposite sign of how the positions change")
    )


def _median_ratio(one: FloatArray, other: FloatArray) -> float:
    """The median of one over the other where this is not zero; 0 where it always is."""
    sound = other != 0.0
    return float(np.median(one[sound] / other[sound])) if sound.any() else 0.0


def _vector(enu_m: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.1f}" for x in enu_m) + ") m"
