"""Checks of ranges against the distances between the positions of their two ends.

The positions are the reported ones, or else the true ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.findings import (
    CALIBRATE,
    DataFinding,
    Explanation,
    FindingKind,
    choose,
    clock_finding,
    finding,
    median_residual_m,
    unit_question,
)
from gcs_coloc.evaluation.data_checks.recorded_data import (
    Mask,
    PositionTrack,
    RecordedData,
    find_small_time_offset_s,
    find_time_offset_s,
    thinned,
)

_LEAST_ROWS = 20
"""Ranges that a pair needs to be checked; chosen: a median of fewer moves with single outliers."""
_MOST_ROWS_OF_PAIR = 400
"""Ranges of a pair that are compared, evenly spaced; chosen: the check of a fleet of ten takes below a second."""
_SUSPECT_SIGMAS = 3.0
"""Median residual, in stated sigmas, from which a pair is checked further; chosen: a Gaussian's median is 0.67."""
_UNEXPLAINED_SIGMAS = 5.0
"""Median residual, in stated sigmas, that is reported even if nothing explains it; chosen: sigmas are often stated too small."""
_MEAN_SIGMAS = 4.0
"""Mean residual of a pair, in its own sigmas (sigma over the root of n), that is a finding; chosen: 1 in 16,000 by chance."""
_MEAN_SHARE = 0.3
"""Least mean residual, in stated sigmas of one range, that is told; chosen: less does not move the coverage of the bound."""
_BETTER_BY_TIME = 0.7
"""Share of the residual that a small time offset may leave; chosen: it must explain half of the variance."""
_MOST_PAIRS_NAMED = 4  # chosen: one line of a terminal
_RATE_SPAN_S = 2.0
"""Half the time over which the rate of change of a distance is measured; chosen: noise of 1 m makes 0.35 m/s of it."""

PositionShift = Callable[[int, bool], float]
"""By how many seconds later the positions of a vehicle are used, of its truth (True) or of its reports (False)."""


def _shift_all(by_s: float) -> PositionShift:
    return lambda _vehicle, _is_truth: by_s


_NO_SHIFT = _shift_all(0.0)


def check_ranges(data: RecordedData, *, trust_truth: bool) -> Iterator[DataFinding]:
    """Yield the finding on the ranges or the positions at their ends.

    A trusted truth stands in for missing reports.
    """
    pairs = list(range_pairs(data, trust_truth=trust_truth))
    if not pairs:
        return
    suspect = [pair for pair in pairs if pair.residual_m() > _SUSPECT_SIGMAS * pair.sigma_m()]
    bad = _RangeSet(suspect) if suspect else None
    clock = _small_clock_offset(_RangeSet(pairs), bad)
    if clock is not None:
        yield clock
    elif bad is not None:
        attributed = _attribute(suspect, pairs, data.names)
        explained = choose(_explanations(bad, attributed), bad.residual_m)
        if explained is not None:
            yield explained
            if explained.kind is FindingKind.RANGE_BIAS:
                yield from _mean_findings([pair for pair in pairs if pair not in suspect], pairs, data.names)
        elif bad.residual_m > _UNEXPLAINED_SIGMAS * bad.sigma_m:
            yield finding(FindingKind.RANGE_RESIDUAL, bad.residual_m, attributed.ranges, sigma_m=bad.sigma_m)
    else:
        yield from _mean_findings(pairs, pairs, data.names)


def _mean_findings(pairs: list[RangePair], among: list[RangePair], names: Mapping[int, str]) -> Iterator[DataFinding]:
    """Yield the ranges that are off in the mean, though each of them is within its sigma.

    More ranges do not average that away. `among` are all pairs, which tell what those that are off have in common.
    """
    means = [pair.mean_m() for pair in pairs]
    off = [
        (pair, mean_m)
        for pair, (mean_m, sigma_m) in zip(pairs, means, strict=True)
        if abs(mean_m) > max(_MEAN_SIGMAS * sigma_m, _MEAN_SHARE * float(np.median(pair.rows[:, 4])))
    ]
    if not off:
        return
    suspect, values = [pair for pair, _ in off], [mean_m for _, mean_m in off]
    expected_m = float(np.median([sigma_m for pair, (_, sigma_m) in zip(pairs, means, strict=True) if pair in suspect]))
    who = _attribute(suspect, among, names).ranges
    # What is off to both sides has no common mean: the worst is told.
    mean_m = float(np.mean(values)) if min(values) * max(values) > 0.0 else max(values, key=abs)
    span = f"{min(values):+.2f} to {max(values):+.2f} m by pair"
    yield finding(FindingKind.RANGE_MEAN, mean_m, who, span=span, sigma_m=expected_m)


@dataclass(slots=True)
class RangePair:
    """The ranges (N, 5) of two vehicles.

    With whether each end's position is from the truth (N, 2) or from its own reports.
    """

    ends: tuple[int, int]
    rows: FloatArray
    from_truth: Mask
    data: RecordedData

    def positions(self, side: int, shift: PositionShift = _NO_SHIFT) -> FloatArray:
        """Return the positions (N, 3) of one end at the times of the ranges, shifted; NaN where unknown."""
        vehicle = self.ends[side]
        positions = np.full((len(self.rows), 3), np.nan)
        for is_truth, tracks in ((False, self.data.reports), (True, self.data.truth)):
            mine = self.from_truth[:, side] == is_truth
            if mine.all():
                found, known = tracks[vehicle].at(self.rows[:, 0] + shift(vehicle, is_truth))
                return found if known.all() else np.where(known[:, np.newaxis], found, np.nan)
            if mine.any():
                found, known = tracks[vehicle].at(self.rows[mine, 0] + shift(vehicle, is_truth))
                positions[mine] = np.where(known[:, np.newaxis], found, np.nan)
        return positions

    def sigma_m(self) -> float:
        """Return the stated sigma of range and both positions together, median."""
        return float(np.sqrt(np.median(self.rows[:, 4]) ** 2 + self.position_variance_m2()))

    def position_variance_m2(self) -> float:
        """Return the stated variance of both positions along the line between them: it does not average out."""
        reported = (vehicle for side, vehicle in enumerate(self.ends) if not self.from_truth[:, side].all())
        return sum(float(np.median(self.data.reports[vehicle].sigmas_m)) ** 2 for vehicle in reported)

    def distances_m(self) -> FloatArray:
        """Return the distances (N,) between the positions."""
        return np.asarray(np.linalg.norm(self.positions(0) - self.positions(1), axis=1))

    def residual_m(self) -> float:
        """Return the median of |range - distance|."""
        return median_residual_m(np.abs(self.rows[:, 3] - self.distances_m()))

    def mean_m(self) -> tuple[float, float]:
        """Return the mean residual without the outer tenths, and its 1-sigma if the stated sigmas are true, m."""
        residuals = self.rows[:, 3] - self.distances_m()
        residuals = np.sort(residuals[np.isfinite(residuals)])
        cut = len(residuals) // 10
        if len(residuals) <= 2 * cut:
            return 0.0, np.inf
        variance = float(np.median(self.rows[:, 4])) ** 2 / len(residuals) + self.position_variance_m2()
        return float(residuals[cut : len(residuals) - cut].mean()), float(np.sqrt(variance))

    def moves(self) -> list[bool]:
        """Return for each end whether it moves: it is no anchor."""
        return [not (end in self.data.reports and self.data.reports[end].is_static) for end in self.ends]


def range_pairs(data: RecordedData, *, trust_truth: bool) -> Iterator[RangePair]:
    """Yield the pairs with enough ranges at times at which both positions are known.

    A trusted truth stands in for reports.
    """
    ends = np.sort(data.ranges[:, 1:3], axis=1)
    truth: Mapping[int, PositionTrack] = data.truth if trust_truth else {}
    for a, b in np.unique(ends, axis=0).astype(int).tolist():
        rows = thinned(data.ranges[(ends[:, 0] == a) & (ends[:, 1] == b)], _MOST_ROWS_OF_PAIR)
        reported, known = np.zeros((2, len(rows), 2), dtype=bool)
        for side, vehicle in enumerate((a, b)):
            if vehicle in data.reports:
                reported[:, side] = data.reports[vehicle].at(rows[:, 0])[1]
            if vehicle in truth:
                known[:, side] = truth[vehicle].at(rows[:, 0])[1]
        usable = (reported | known).all(axis=1)
        if usable.sum() >= _LEAST_ROWS:
            yield RangePair((a, b), rows[usable], ~reported[usable], data)


@dataclass(frozen=True, slots=True)
class _Attribution:
    """To what a residual is attributed: the suspect ranges, and the one vehicle that they all share.

    The ranges are in words. That vehicle, if there is one, has no range that is not suspect. `positions_fit`: each vehicle has
    other ranges, which fit its positions.
    """

    ranges: str
    vehicle: int | None = None
    name: str = ""
    positions_fit: bool = False


def _attribute(suspect: list[RangePair], pairs: list[RangePair], names: Mapping[int, str]) -> _Attribution:
    if len(suspect) == len(pairs):
        return _Attribution("the ranges")
    sound = {vehicle for pair in pairs if pair not in suspect for vehicle in pair.ends}
    shared = {vehicle for pair in suspect for vehicle in pair.ends} - sound
    if len(shared) == 1 and all(shared & set(pair.ends) for pair in suspect):
        vehicle = shared.pop()
        return _Attribution(f"the ranges to and from {names[vehicle]}", vehicle, names[vehicle])
    named = [f"{names[a]}-{names[b]}" for a, b in (pair.ends for pair in suspect[:_MOST_PAIRS_NAMED])]
    more = ", ..." if len(suspect) > _MOST_PAIRS_NAMED else ""
    return _Attribution(f"the ranges {', '.join(named)}{more}", positions_fit=not shared)


class _RangeSet:
    """The ranges (N,) of several pairs, with the positions (N, 2, 3) of both ends.

    Its methods return residuals under other readings of the positions.
    """

    def __init__(self, pairs: list[RangePair]) -> None:
        self.pairs = pairs
        self.range_m = np.concatenate([pair.rows[:, 3] for pair in pairs])
        self.from_truth = np.concatenate([pair.from_truth for pair in pairs])
        self.vehicles = np.concatenate([np.broadcast_to(pair.ends, (len(pair.rows), 2)) for pair in pairs])
        self.moves = np.concatenate([np.broadcast_to(pair.moves(), (len(pair.rows), 2)) for pair in pairs])
        self.ends = self._ends()
        self.distances_m = np.linalg.norm(self.ends[:, 0] - self.ends[:, 1], axis=1)
        self.sigma_m = float(np.median([pair.sigma_m() for pair in pairs]))
        self.residual_m = median_residual_m(self.range_m - self.distances_m)

    def _ends(self, shift: PositionShift = _NO_SHIFT) -> FloatArray:
        sides = [np.concatenate([pair.positions(side, shift) for pair in self.pairs]) for side in (0, 1)]
        return np.stack(sides, axis=1)

    def swapped_residual_m(self, whose: Mask) -> float:
        """Return the median residual if east and north are exchanged in some positions (N, 2)."""
        ends = self.ends.copy()
        ends[whose] = ends[whose][:, (1, 0, 2)]
        return median_residual_m(self.range_m - np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))

    def shifted_residuals_m(self, shift: PositionShift) -> FloatArray:
        """Return the residuals (N,) if positions of other times are used."""
        ends = self._ends(shift)
        return np.asarray(self.range_m - np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))

    def rate_mps(self) -> float:
        """Return the median rate of change of the distances.

        It is taken over a time in which the noise of positions makes little of it.
        """
        before, after = (self._ends(_shift_all(by_s)) for by_s in (-_RATE_SPAN_S, _RATE_SPAN_S))
        change_m = np.linalg.norm(after[:, 0] - after[:, 1], axis=1) - np.linalg.norm(before[:, 0] - before[:, 1], axis=1)
        rates = np.abs(change_m[np.isfinite(change_m)]) / (2.0 * _RATE_SPAN_S)
        return float(np.median(rates)) if len(rates) else 0.0


def _explanations(bad: _RangeSet, attributed: _Attribution) -> Iterator[Explanation]:
    """Yield what may be wrong, simplest first: the unit, the axes, a clock, a bias, a factor of no unit.

    Axes and clocks of positions that fit other ranges are right.
    """
    factor, scaled_m = 0.0, float("inf")
    sound = bad.distances_m > 0.0
    if sound.any() and (factor := float(np.nanmedian(bad.range_m[sound] / bad.distances_m[sound]))) > 0.0:
        scaled_m = median_residual_m(bad.range_m / factor - bad.distances_m)
        question = unit_question(factor, "the ranges in {}", "the positions in {}")
        if question:
            yield Explanation(scaled_m, finding(FindingKind.RANGE_FACTOR, factor, attributed.ranges, question=question))
    for of, whose in _position_groups(bad, attributed):
        if whose.any():
            left_m = bad.swapped_residual_m(whose)
            swapped = finding(
                FindingKind.POSITION_AXES,
                None,
                attributed.ranges,
                axes="east and north are swapped",
                of=of,
                before_m=bad.residual_m,
                after_m=left_m,
            )
            yield Explanation(left_m, swapped)
    for of, shift in _clocks(bad, attributed):
        offset_s, left_m = find_time_offset_s(lambda by_s, shift=shift: bad.shifted_residuals_m(shift(by_s)))  # type: ignore[misc]
        yield Explanation(left_m, clock_finding(of, attributed.ranges, offset_s, bad.residual_m, left_m))
    bias_m = float(np.nanmedian(bad.range_m - bad.distances_m))
    # A bias or factor of any size fits by chance more easily: it must explain all of the residual.
    if (left_m := median_residual_m(bad.range_m - bias_m - bad.distances_m)) <= _SUSPECT_SIGMAS * bad.sigma_m:
        yield Explanation(left_m, finding(FindingKind.RANGE_BIAS, bias_m, attributed.ranges))
    if scaled_m <= _SUSPECT_SIGMAS * bad.sigma_m:
        yield Explanation(scaled_m, finding(FindingKind.RANGE_FACTOR, factor, attributed.ranges, question=CALIBRATE))


def _position_groups(bad: _RangeSet, attributed: _Attribution) -> Iterator[tuple[str, Mask]]:
    if attributed.positions_fit:
        return
    if attributed.vehicle is not None:
        yield f"positions of {attributed.name}", bad.vehicles == attributed.vehicle
        return
    yield "truth", bad.from_truth
    yield "reported positions", ~bad.from_truth & bad.moves
    yield "positions of the anchors", ~bad.moves


def _clocks(bad: _RangeSet, attributed: _Attribution) -> Iterator[tuple[str, Callable[[float], PositionShift]]]:
    """Yield the positions that may have a clock of their own, in words, and how they are shifted."""
    if attributed.positions_fit or not bad.moves.any():
        return
    yield "the positions", _shift_all
    if attributed.vehicle is not None:
        yield (
            f"the positions of {attributed.name}",
            lambda by_s: lambda vehicle, _: by_s if vehicle == attributed.vehicle else 0.0,
        )
    if bad.from_truth.any() and (~bad.from_truth & bad.moves).any():
        yield "the truth", lambda by_s: lambda _, is_truth: by_s if is_truth else 0.0


def _small_clock_offset(every: _RangeSet, bad: _RangeSet | None) -> DataFinding | None:
    """Return the finding of a time offset of all positions that is hidden in most pairs.

    None unless the offset moves vehicles by more than the noise.
    """
    if not every.moves.any():
        return None
    offset_s, left_m = find_small_time_offset_s(lambda by_s: every.shifted_residuals_m(_shift_all(by_s)))
    if left_m >= _BETTER_BY_TIME * every.residual_m or abs(offset_s) * every.rate_mps() <= every.sigma_m:
        return None
    if bad is not None and median_residual_m(bad.shifted_residuals_m(_shift_all(offset_s))) > _SUSPECT_SIGMAS * bad.sigma_m:
        return None
    return clock_finding("the positions", "the ranges", offset_s, every.residual_m, left_m)
