"""Data-quality findings: their kinds and wording, and the choice among several explanations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_MOST_NAMED = 6
"""Vehicles named in one finding; chosen: what fits on a line."""
_CLEARLY_BETTER = 1.0 / 3.0
"""Largest residual an explanation may leave, as a share of the residual before it; chosen: chance halves it at most."""
_AS_GOOD = 1.5
"""A simpler explanation wins up to this multiple of the least residual; chosen: medians of 20 values scatter so."""
_NOISE_SIGMAS = 3.0
"""What an explanation leaves within so many stated sigmas is noise; chosen: 1 in 370 of a Gaussian is beyond."""
_SAME_UNIT = 0.02
"""Logarithm of how far a factor may be from a unit's; chosen: feet (3.28) and pi (3.14) stay apart."""
_SAME_POWER = 0.1
"""The same where the unit's factor is 100 or 1000; chosen: in a room a bias of 0.1 m is 7 % of the distances."""
_LEAST_SHARE = 0.5
"""Share of the values that must be comparable for a median to count; chosen: the median is then one of the data's middle half."""


class FindingKind(StrEnum):
    """What does not agree in a recording; the value stands in the JSON as `kind`."""

    DROPPED_ROWS = "dropped_rows"
    NO_OVERLAP = "no_overlap"
    SLOW_RANGES = "slow_ranges"
    LATE_ARRIVAL = "late_arrival"
    REPEATED_RANGES = "repeated_ranges"
    STUCK_RANGES = "stuck_ranges"
    TIME_OFFSET = "time_offset"
    RANGE_FACTOR = "range_factor"
    RANGE_BIAS = "range_bias"
    RANGE_RESIDUAL = "range_residual"
    RANGE_MEAN = "range_mean"
    POSITION_AXES = "position_axes"
    TRUTH_FACTOR = "truth_factor"
    TRUTH_AXES = "truth_axes"
    TRUTH_HEIGHT_FACTOR = "truth_height_factor"
    TRUTH_OFFSET = "truth_offset"
    TRUTH_RESIDUAL = "truth_residual"
    TRUTH_ELSEWHERE = "truth_elsewhere"
    HEIGHT_FACTOR = "height_factor"
    HEIGHT_SIGN = "height_sign"
    HEIGHT_OFFSET = "height_offset"
    HEIGHT_RESIDUAL = "height_residual"
    VELOCITY_FACTOR = "velocity_factor"
    VELOCITY_AXES = "velocity_axes"
    VELOCITY_SIGN = "velocity_sign"
    VELOCITY_RESIDUAL = "velocity_residual"


CALIBRATE = " (gcs-coloc calibrate estimates it)"
"""The remedy for ranges of devices that are off."""

_WORDING = {
    FindingKind.DROPPED_ROWS: "{value} of {rows} rows of {who} are wrong and left out: {first}",
    FindingKind.NO_OVERLAP: "only {value:.1%} of the {who} ({span}) fall into the time of the ranges ({range_span}): "
    "all times must be seconds of one clock",
    FindingKind.SLOW_RANGES: "the ranges of a pair come every {value:.4g} s in the median: are times in milliseconds?",
    FindingKind.LATE_ARRIVAL: "{who} arrive {value:.4g} s after they were measured in the median: "
    "is arrival_s on the clock of t_s?",
    FindingKind.REPEATED_RANGES: "{value} ranges occur twice, with the same time, vehicles and value: each counts "
    "as a measurement of its own and makes the result look more certain than it is",
    FindingKind.STUCK_RANGES: "{who} repeat one value ({range_m:.10g} m) for {value:.0f} s while others "
    "change: did the radio answer?",
    FindingKind.TIME_OFFSET: "the clock of {of} is {offset} that of {than} ({before_m:.3g} m of residual in the median, "
    "{after_m:.3g} m with the offset removed)",
    FindingKind.RANGE_FACTOR: "{who} are {value:.4g} times the distances between the positions{question}",
    FindingKind.RANGE_BIAS: "{who} are {value:+.4g} m off the distances between the positions throughout"
    f"{CALIBRATE}",
    FindingKind.RANGE_RESIDUAL: "{who} differ from the distances between the positions by {value:.3g} m in the median, where "
    "{sigma_m:.3g} m are stated",
    FindingKind.RANGE_MEAN: "{who} are {value:+.2f} m off in the mean ({span}), where {sigma_m:.3f} m are left by chance: a bias "
    f"that more ranges do not average away{CALIBRATE}",
    FindingKind.POSITION_AXES: "{who} fit if {axes} in the {of} ({before_m:.3g} m of residual in the median, "
    "{after_m:.3g} m then)",
    FindingKind.TRUTH_FACTOR: "the truth of {who} is {value:.4g} times the reported positions{question}",
    FindingKind.TRUTH_AXES: "the truth of {who} fits the reported positions if {axes} in one of the two",
    FindingKind.TRUTH_HEIGHT_FACTOR: "the heights in the truth of {who} are {value:.4g} times the reported heights{question}",
    FindingKind.TRUTH_OFFSET: "the truth of {who} lies {offset} m (east, north, up) off the reported positions throughout",
    FindingKind.TRUTH_RESIDUAL: "the truth of {who} is {value:.3g} m off the reported positions in the median, where "
    "{sigma_m:.3g} m are stated",
    FindingKind.TRUTH_ELSEWHERE: "the truth lies {km:.0f} km off the reported positions{question}",
    FindingKind.HEIGHT_FACTOR: "the heights of {who} are {value:.4g} times those of the {of}{question}",
    FindingKind.HEIGHT_SIGN: "the heights of {who} have the opposite sign of the {of}: do they count downwards?",
    FindingKind.HEIGHT_OFFSET: "the heights of {who} are {value:+.4g} m off the {of} throughout",
    FindingKind.HEIGHT_RESIDUAL: "the heights of {who} are {value:.3g} m off the {of} in the median, where "
    "{sigma_m:.3g} m are stated",
    FindingKind.VELOCITY_FACTOR: "the velocities of {who} are {value:.4g} times the rate of change of the positions{question}",
    FindingKind.VELOCITY_AXES: "the velocities of {who} fit the rate of change of the positions if {axes} in them",
    FindingKind.VELOCITY_SIGN: "the velocities of {who} have the opposite sign of the rate of change of the positions",
    FindingKind.VELOCITY_RESIDUAL: "the velocities of {who} are {value:.3g} m/s off the rate of change of the positions "
    "in the median",
}  # fmt: skip
"""The one place of all wording. `{who}` is filled in when the findings of several vehicles are joined."""


@dataclass(frozen=True, slots=True)
class DataFinding:
    """One disagreement in a recording.

    `value` is the factor, the seconds or the metres, None where no one number says it.
    """

    kind: FindingKind
    text: str
    value: float | None = None


def finding(kind: FindingKind, value: float | None = None, who: str = "{who}", **words: object) -> DataFinding:
    """Return a finding in its kind's wording.

    Without `who` the place of the names stays open for `join_vehicles`.
    """
    return DataFinding(kind, _WORDING[kind].format(value=value, who=who, **words), value)


@dataclass(frozen=True, slots=True)
class Explanation:
    """One way to make data agree: the median residual that remains, m, and the finding if it is right."""

    residual_m: float
    finding: DataFinding


def clock_finding(of: str, than: str, offset_s: float, before_m: float, after_m: float) -> DataFinding:
    """Return that the clock of `of` is `offset_s` ahead of that of `than`.

    `before_m` and `after_m`: the median residual as it is, and with the offset removed.
    """
    offset = f"{abs(offset_s):.2f} s {'ahead of' if offset_s > 0.0 else 'behind'}"
    return finding(FindingKind.TIME_OFFSET, offset_s, of=of, than=than, offset=offset, before_m=before_m, after_m=after_m)


def choose(explanations: Iterable[Explanation], residual_m: float, sigma_m: float = 0.0) -> DataFinding | None:
    """Return the simplest explanation (the first) that is good enough.

    It is clearly better than none, and as good as the best or within noise.
    """
    candidates = list(explanations)
    least_m = min((one.residual_m for one in candidates), default=math.inf)
    enough_m = min(max(_AS_GOOD * least_m, _NOISE_SIGMAS * sigma_m), _CLEARLY_BETTER * residual_m)
    return next((one.finding for one in candidates if one.residual_m <= enough_m), None)


def join_vehicles(findings: Iterable[tuple[str, DataFinding]]) -> Iterator[DataFinding]:
    """Yield one finding for each kind among (vehicle's name, finding).

    It has the first value and the names of all vehicles.
    """
    by_kind: dict[FindingKind, list[tuple[str, DataFinding]]] = {}
    for name, one in findings:
        by_kind.setdefault(one.kind, []).append((name, one))
    for of_kind in by_kind.values():
        names, first = [name for name, _ in of_kind], of_kind[0][1]
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        text = first.text.replace("{who}", ", ".join(names[:_MOST_NAMED]) + more)
        yield DataFinding(first.kind, text, first.value)


_FACTORS = {1000.0: ("mm", "km"), 100.0: ("cm", ""), 1.0 / 0.3048: ("ft", "")}
"""How many of the first unit are one metre, and how many metres one of the second (foot: 0.3048 m, ISO 31-1)."""


def unit_question(factor: float, one: str, other: str) -> str:
    """Return ": are ...?" if a quantity is a known unit's multiple of another one, else "".

    `factor` is the first quantity over the other. `one` and `other` name them, each with "{}" for the unit.
    """
    for known, (small, large) in _FACTORS.items():
        for first, second, wanted in ((one, other, known), (other, one, 1.0 / known)):
            if factor > 0.0 and abs(math.log(factor / wanted)) < (_SAME_UNIT if known < 100.0 else _SAME_POWER):
                guesses = [first.format(small), *([second.format(large)] if large else [])]
                return f": are {', or '.join(guesses)}?"
    return ""


def median_residual_m(residuals_m: FloatArray) -> float:
    """Return the median magnitude of the finite residuals; infinite where fewer than half are finite."""
    known = np.abs(residuals_m[np.isfinite(residuals_m)])
    return float(np.median(known)) if len(known) >= _LEAST_SHARE * len(residuals_m) and len(known) else math.inf


def median_ratio(one: FloatArray, other: FloatArray) -> float:
    """Return the median of one over the other where the other is not zero; 0 where it always is."""
    sound = other != 0.0
    return float(np.median(one[sound] / other[sound])) if sound.any() else 0.0
