"""The bounds of settings, declared beside each default, checked and printed in the reference."""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, TypeVar

T = TypeVar("T", int, float, float | None)
_KEY = "bounds"


@dataclass(frozen=True, slots=True)
class Bounds:
    """The least (excluded if `open_below`) and the most that a setting may be; infinity for no bound."""

    least: float = -math.inf
    most: float = math.inf
    open_below: bool = False

    def admit(self, value: float) -> bool:
        """Return whether a finite number lies within."""
        return (
            math.isfinite(value) and (value > self.least or (not self.open_below and value == self.least)) and value <= self.most
        )

    def __str__(self) -> str:
        if self.open_below:
            return f"above {self.least:g}" + (f", at most {self.most:g}" if self.most < math.inf else "")
        return f"at least {self.least:g}" if self.most == math.inf else f"from {self.least:g} to {self.most:g}"


def positive(default: T, most: float = math.inf) -> T:
    """A setting above zero."""
    made: T = field(default=default, metadata={_KEY: Bounds(0.0, most, open_below=True)})
    return made


def between(default: T, least: float, most: float = math.inf) -> T:
    """A setting from `least` to `most`, both included."""
    made: T = field(default=default, metadata={_KEY: Bounds(least, most)})
    return made


def field_bounds(one: Field[Any]) -> Bounds | None:
    """Return the bounds that a field of settings declares; None where it declares none."""
    return one.metadata.get(_KEY)


def check_bounds(settings: Any) -> None:
    """Check every number of a dataclass of settings against its bounds; None is within.

    Raises:
        ValueError: a number is outside; the text names the setting, its bounds and the number.
    """
    for one in fields(settings):
        bounds, value = field_bounds(one), getattr(settings, one.name)
        if bounds is not None and value is not None and not bounds.admit(value):
            raise ValueError(f"{one.name} must be {bounds}, not {value:g}")
