"""Ranges held against the distances between where their ends say that they are, or truly are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.evidence import Evidence, thinned
from gcs_coloc.evaluation.data_checks.finding import DataFinding, length_unit, range_unit
from gcs_coloc.evaluation.data_checks.readings import Reading, good, median_misfit_m, small_time_offset_s, time_offset_s
from gcs_coloc.evaluation.data_checks.tracks import Mask, PositionTrack

_LEAST_ROWS = 20
_MOST_ROWS_OF_PAIR = 400
_DOUBTFUL_SIGMAS = 3.0
_UNEXPLAINED_SIGMAS = 5.0
_BETTER_BY_TIME = 0.7
_GENEROUS_SIGMAS = 50.0
_EXACT_M = 1e-3
_MOST_NAMED = 4
_LAT_MAX, _LON_MAX = 90.0, 180.0
_FOOT_M = 0.3048
_RATE_S = 2.0


Later = Callable[[int, bool], float]
"""How much later a row is to be taken, in seconds, of a vehicle's truth or of its own reports."""


def _as_it_stands(vehicle: int, is_truth: bool) -> float:  # noqa: ARG001 - a Later
    return 0.0


@dataclass(slots=True)
class _Pair:
    """The ranges of two vehicles, and where each end's position at their times is taken from (N, 2): truth or its own report."""

    ends: tuple[int, int]
    rows: FloatArray
    from_truth: Mask
    evidence: Evidence

    def positions(self, side: int, later_s: Later = _as_it_stands) -> FloatArray:
        """Positions (N, 3) of one end, NaN where there is none, from rows so much later."""
        vehicle = self.ends[side]
        where = np.full((len(self.rows), 3), np.nan)
        for is_truth, tracks in ((False, self.evidence.reports), (True, self.evidence.truth)):
            mine = self.from_truth[:, side] == is_truth
            if mine.any():
                found, known = tracks[vehicle].at(self.rows[mine, 0] + later_s(vehicle, is_truth))
                where[mine] = np.where(known[:, np.newaxis], found, np.nan)
        return where


def check_distances(evidence: Evidence, *, trust_truth: bool) -> Iterator[DataFinding]:
    """Yield what is wrong with ranges, or with the positions between them; with `trust_truth` where only the truth knows, too."""
    pairs = list(_pairs(evidence, trust_truth=trust_truth))
    if not pairs:
        return
    doubtful = [pair for pair in pairs if _misfit_m(pair) > _DOUBTFUL_SIGMAS * _sigma_m(pair)]
    of_all = _small_offset(_Lines(pairs), _Lines(doubtful) if doubtful else None)
    if of_all is not None:
        yield of_all
    elif doubtful:
        yield from _doubt(_Lines(doubtful), _whose(doubtful, pairs, evidence.names))
    else:
        yield from _generous(_Lines(pairs))


def _doubt(bad: _Lines, who: _Who) -> Iterator[DataFinding]:
    found = good(_readings(bad, who), bad.misfit_m)
    if found:
        yield found[0]
    elif bad.misfit_m > _UNEXPLAINED_SIGMAS * bad.sigma_m:
        yield DataFinding(
            "range_misfit",
            f"{who.ranges} differ from the distances between the positions by {bad.misfit_m:.3g} m in the median, where "
            f"{bad.sigma_m:.3g} m are stated{_degrees(bad)}",
            bad.misfit_m,
        )


def _pairs(evidence: Evidence, *, trust_truth: bool) -> Iterator[_Pair]:
    ends = np.sort(evidence.ranges[:, 1:3], axis=1)
    truth: Mapping[int, PositionTrack] = evidence.truth if trust_truth else {}
    for a, b in np.unique(ends, axis=0).astype(int).tolist():
        rows = thinned(evidence.ranges[(ends[:, 0] == a) & (ends[:, 1] == b)], _MOST_ROWS_OF_PAIR)
        reported, known = np.zeros((2, len(rows), 2), dtype=bool)
        for side, vehicle in enumerate((a, b)):
            if vehicle in evidence.reports:
                reported[:, side] = evidence.reports[vehicle].at(rows[:, 0])[1]
            if vehicle in truth:
                known[:, side] = truth[vehicle].at(rows[:, 0])[1]
        usable = (reported | known).all(axis=1)
        if usable.sum() >= _LEAST_ROWS:
            yield _Pair((a, b), rows[usable], ~reported[usable], evidence)


def _sigma_m(pair: _Pair) -> float:
    squares = pair.rows[:, 4] ** 2
    for side, vehicle in enumerate(pair.ends):
        if not pair.from_truth[:, side].all():
            squares = squares + float(np.median(pair.evidence.reports[vehicle].sigmas_m)) ** 2
    return float(np.sqrt(np.median(squares)))


def _misfit_m(pair: _Pair) -> float:
    return median_misfit_m(np.abs(pair.rows[:, 3] - np.linalg.norm(pair.positions(0) - pair.positions(1), axis=1)))


@dataclass(frozen=True, slots=True)
class _Who:
    """What the doubtful ranges are called, and the one vehicle whose positions may be wrong, where only its ranges are."""

    ranges: str
    vehicle: int | None
    name: str


def _whose(doubtful: list[_Pair], pairs: list[_Pair], names: Mapping[int, str]) -> _Who:
    if len(doubtful) == len(pairs):
        return _Who("the ranges", None, "")
    sound = {vehicle for pair in pairs if pair not in doubtful for vehicle in pair.ends}
    guilty = {vehicle for pair in doubtful for vehicle in pair.ends} - sound
    if len(guilty) == 1 and all(guilty & set(pair.ends) for pair in doubtful):
        vehicle = guilty.pop()
        return _Who(f"the ranges to and from {names[vehicle]}", vehicle, names[vehicle])
    words = [f"{names[a]}-{names[b]}" for a, b in (pair.ends for pair in doubtful[:_MOST_NAMED])]
    return _Who(f"the ranges {', '.join(words)}{', ...' if len(doubtful) > _MOST_NAMED else ''}", None, "")


class _Lines:
    """The ranges of several pairs, with both ends (N, 3) of each."""

    def __init__(self, pairs: list[_Pair]) -> None:
        self.pairs = pairs
        self.range_m = np.concatenate([pair.rows[:, 3] for pair in pairs])
        self.from_truth = np.concatenate([pair.from_truth for pair in pairs])
        self.vehicles = np.concatenate([np.broadcast_to(pair.ends, (len(pair.rows), 2)) for pair in pairs])
        self.moves = np.array([[not _is_anchor(pair, end) for end in pair.ends] for pair in pairs])
        self.may_move = np.repeat(self.moves, [len(pair.rows) for pair in pairs], axis=0)
        self.ends = self._both()
        self.sigma_m = float(np.median([_sigma_m(pair) for pair in pairs]))
        self.misfit_m = median_misfit_m(self.misfits_m())

    def _both(self, later_s: Later = _as_it_stands) -> FloatArray:
        """Both ends of each range (N, 2, 3)."""
        sides = [np.concatenate([pair.positions(side, later_s) for pair in self.pairs]) for side in (0, 1)]
        return np.stack(sides, axis=1)

    def distances_m(self) -> FloatArray:
        return np.asarray(np.linalg.norm(self.ends[:, 0] - self.ends[:, 1], axis=1))

    def misfits_m(self, ends: FloatArray | None = None) -> FloatArray:
        ends = self.ends if ends is None else ends
        return np.asarray(np.abs(self.range_m - np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)))

    def changed(self, whose: Mask, axes: tuple[int, int, int], height: float) -> FloatArray:
        """The misfits where the positions of some ends (N, 2) are read with other axes and heights times a factor."""
        ends = self.ends.copy()
        ends[whose] = ends[whose][:, axes] * (1.0, 1.0, height)
        return self.misfits_m(ends)

    def later(self, later_s: Later) -> FloatArray:
        """The misfits where positions are taken from later rows."""
        return self.misfits_m(self._both(later_s))

    def rate_mps(self) -> float:
        """The median speed at which the distances change, over a time in which noise makes little of it."""
        ends = [self._both(_put_all_forward(by_s)) for by_s in (-_RATE_S, _RATE_S)]
        before_m, after_m = (np.linalg.norm(both[:, 0] - both[:, 1], axis=1) for both in ends)
        rates = np.abs(after_m - before_m) / (2.0 * _RATE_S)
        known = rates[np.isfinite(rates)]
        return float(np.median(known)) if len(known) else 0.0


def _is_anchor(pair: _Pair, vehicle: int) -> bool:
    return vehicle in pair.evidence.reports and pair.evidence.reports[vehicle].is_static


def _readings(bad: _Lines, who: _Who) -> Iterator[Reading]:
    before = f"{bad.misfit_m:.3g} m of misfit in the median as they stand"
    distances_m = bad.distances_m()
    sound = distances_m > 0.0
    factor = float(np.median(bad.range_m[sound] / distances_m[sound])) if sound.any() else 0.0
    unit = _unit(factor) if factor > 0.0 else ""
    scaled_m = median_misfit_m(np.abs(bad.range_m / factor - distances_m)) if factor > 0.0 else float("inf")
    text = f"{who.ranges} are {factor:.4g} times the distances between the positions"
    if unit:
        yield Reading(scaled_m, DataFinding("range_factor", f"{text}: are {unit}?", factor))
    for name, whose in _groups(bad, who):
        if whose.any():
            for axes, height, what in (
                ((1, 0, 2), 1.0, "east and north are swapped"),
                ((0, 1, 2), _FOOT_M, "heights are in feet"),
                ((0, 1, 2), -1.0, "heights count downwards"),
            ):
                left_m = median_misfit_m(bad.changed(whose, axes, height))
                fits = f"{who.ranges} fit if in the {name} {what} ({before}, {left_m:.3g} m then)"
                yield Reading(left_m, DataFinding("position_axes", fits))
    for positions, clock in _clocks(bad, who):
        offset_s, left_m = time_offset_s(lambda later_s, clock=clock: bad.later(clock(later_s)))  # type: ignore[misc]
        yield Reading(left_m, _time_doubt(who.ranges, positions, offset_s, f"({before}, {left_m:.3g} m then)"))
    bias_m = float(np.nanmedian(bad.range_m - distances_m))
    left_m = median_misfit_m(np.abs(bad.range_m - bias_m - distances_m))
    sign = "longer" if bias_m > 0.0 else "shorter"
    # A number that may be any is believed only where it explains all.
    if left_m <= _DOUBTFUL_SIGMAS * bad.sigma_m:
        words = f"{who.ranges} are {abs(bias_m):.4g} m {sign} than the distances between the positions"
        yield Reading(left_m, DataFinding("range_bias", words, bias_m))
    if scaled_m <= _DOUBTFUL_SIGMAS * bad.sigma_m:
        yield Reading(scaled_m, DataFinding("range_factor", text, factor))


def _groups(bad: _Lines, who: _Who) -> Iterator[tuple[str, Mask]]:
    if who.vehicle is not None:
        yield f"positions of {who.name}", (bad.vehicles == who.vehicle)
        return
    yield "truth", bad.from_truth
    yield "reported positions", ~bad.from_truth & bad.may_move
    yield "anchors' places", ~bad.may_move


def _clocks(bad: _Lines, who: _Who) -> Iterator[tuple[str, Callable[[float], Later]]]:
    """What may have a clock of its own, in words, and how it is put forward."""
    if not bad.may_move.any():
        return
    yield "the positions", _put_all_forward
    if who.vehicle is not None:
        yield f"the positions of {who.name}", lambda by_s: lambda vehicle, _: by_s if vehicle == who.vehicle else 0.0
    if bad.from_truth.any() and (~bad.from_truth & bad.may_move).any():
        yield "the truth", lambda by_s: lambda _, is_truth: by_s if is_truth else 0.0


def _put_all_forward(by_s: float) -> Later:
    return lambda _vehicle, _is_truth: by_s


def _time_doubt(ranges: str, positions: str, offset_s: float, detail: str) -> DataFinding:
    which = "later" if offset_s < 0.0 else "earlier"
    return DataFinding(
        "time_offset", f"{ranges} fit {positions} if these are stamped {abs(offset_s):.2f} s {which} {detail}", offset_s
    )


def _small_offset(lines: _Lines, bad: _Lines | None) -> DataFinding | None:
    """An offset of all positions that is larger than the noise on the way, though this may hide it in most ranges."""
    if not lines.may_move.any():
        return None
    offset_s, left_m = small_time_offset_s(lambda later_s: lines.later(_put_all_forward(later_s)))
    if left_m >= _BETTER_BY_TIME * lines.misfit_m or abs(offset_s) * lines.rate_mps() <= lines.sigma_m:
        return None
    if bad is not None and median_misfit_m(bad.later(_put_all_forward(offset_s))) > _DOUBTFUL_SIGMAS * bad.sigma_m:
        return None
    detail = f"({lines.misfit_m:.3g} m of misfit in the median as they stand, {left_m:.3g} m then)"
    return _time_doubt("the ranges", "the positions", offset_s, detail)


def _generous(lines: _Lines) -> Iterator[DataFinding]:
    if _EXACT_M < lines.misfit_m < lines.sigma_m / _GENEROUS_SIGMAS:
        yield DataFinding(
            "sigma_factor",
            f"the stated sigmas of ranges and positions ({lines.sigma_m:.3g} m together) are "
            f"{lines.sigma_m / lines.misfit_m:.3g} times what the ranges are off: are they in another unit?",
            lines.sigma_m / lines.misfit_m,
        )


def _unit(factor: float) -> str:
    """What a factor of ranges over distances means, as the end of a question; empty where it is no known one."""
    of_ranges, of_positions = range_unit(factor), length_unit(1.0 / factor)
    guesses = [f"the ranges {of_ranges}"] if of_ranges else []
    guesses += [f"the positions {of_positions}"] if of_positions and factor < 1.0 else []
    return ", or ".join(guesses)


def _degrees(bad: _Lines) -> str:
    reach = np.nanmax(np.abs(bad.ends), axis=(0, 1))
    if reach[0] <= _LON_MAX and reach[1] <= _LAT_MAX and float(np.median(bad.range_m)) > 2.0 * _LON_MAX:
        return ": are the positions in degrees?"
    return ""
