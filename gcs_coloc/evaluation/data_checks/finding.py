"""What is said of data that do not agree."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class DataFinding:
    """`kind` is a word for programs; `value` the factor, the seconds or the metres found, None where there is no one number."""

    kind: str
    text: str
    value: float | None = None

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return {"kind": self.kind, "text": self.text, "value": self.value}


def told_together(doubts: Iterable[tuple[str, list[DataFinding]]]) -> Iterator[DataFinding]:
    """Yield as few doubts as explain everybody's, the first of each kind's with the names of all whom it is of for `{who}`.

    Args:
        doubts: each vehicle's name, and the doubts that would each explain what is wrong with it, simplest first.
    """
    open_ = dict(doubts)
    while open_:
        of_kind: dict[str, list[str]] = {}
        for name, possible in open_.items():
            for kind in dict.fromkeys(doubt.kind for doubt in possible):
                of_kind.setdefault(kind, []).append(name)
        kind, names = max(of_kind.items(), key=lambda item: len(item[1]))
        doubt = next(doubt for doubt in open_[names[0]] if doubt.kind == kind)
        more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
        yield replace(doubt, text=doubt.text.replace("{who}", ", ".join(names[:_MOST_NAMED]) + more))
        open_ = {name: possible for name, possible in open_.items() if name not in names}


_MOST_NAMED = 6

_LENGTHS = {
    1000.0: "in millimetres",
    100.0: "in centimetres",
    10.0: "in decimetres",
    0.001: "in kilometres",
    1.0 / 0.3048: "in feet",
    1.0 / 0.9144: "in yards",
    1.0 / 0.0254: "in inches",
    1.0 / 1852.0: "in nautical miles",
}
_RANGES = {
    2.0: "there and back",
    1.0e9 / 299_792_458.0: "in nanoseconds of flight",
    2.0e9 / 299_792_458.0: "in nanoseconds of flight there and back",
    **_LENGTHS,
}
_SPEEDS = {
    1000.0: "the velocities in mm/s, or times in milliseconds",
    100.0: "the velocities in cm/s",
    3.6: "the velocities in km/h",
    3600.0 / 1852.0: "the velocities in knots",
    1.0 / 0.3048: "the velocities in ft/s",
    1.0e6: "times in microseconds",
    0.3048: "the positions in feet",
    0.01: "the positions in centimetres",
    0.001: "the positions in millimetres",
}
_SAME = 0.02


def length_unit(factor: float) -> str:
    """What lengths may be given in that are `factor` times the metres; empty where nothing is known."""
    return _named(factor, _LENGTHS)


def range_unit(factor: float) -> str:
    """What ranges may be given in that are `factor` times the metres; empty where nothing is known."""
    return _named(factor, _RANGES)


def speed_unit(factor: float) -> str:
    """What is in other units where speeds are `factor` times how fast positions change; empty where nothing is known."""
    return _named(factor, _SPEEDS)


def _named(factor: float, units: dict[float, str]) -> str:
    nearest = min(units, key=lambda known: abs(math.log(factor / known)))
    return units[nearest] if abs(math.log(factor / nearest)) < _SAME else ""
