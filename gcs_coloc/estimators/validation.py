"""Validation of what an estimator is given: the values of measurements, and the bounds of settings."""

from __future__ import annotations

import math
import typing
from dataclasses import dataclass, fields
from typing import Any

from gcs_coloc.core.errors import EstimatorError
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)


@dataclass(frozen=True, slots=True)
class Bounds:
    """The values that a number in a settings dataclass may have: `window_s: Annotated[float, Bounds(above=0.0)] = 1.0`."""

    above: float = -math.inf
    """Exclusive lower bound."""
    least: float = -math.inf
    """Inclusive lower bound."""
    below: float = math.inf
    """Exclusive upper bound."""
    most: float = math.inf
    """Inclusive upper bound."""

    def holds(self, value: float) -> bool:
        """Return whether a number is finite and within the bounds."""
        return math.isfinite(value) and self.above < value < self.below and self.least <= value <= self.most

    def __str__(self) -> str:
        named = (("above", self.above), ("at least", self.least), ("below", self.below), ("at most", self.most))
        return " and ".join(f"{word} {bound:g}" for word, bound in named if math.isfinite(bound)) or "finite"


def bounds_of(settings_type: type[Any]) -> dict[str, Bounds | tuple[object, ...]]:
    """Return the bounds, or the possible values of a Literal, of each field of a settings dataclass that has any."""
    found: dict[str, Bounds | tuple[object, ...]] = {}
    for key, hint in typing.get_type_hints(settings_type, include_extras=True).items():
        if typing.get_origin(hint) is typing.Literal:
            found[key] = typing.get_args(hint)
        for extra in getattr(hint, "__metadata__", ()):
            if isinstance(extra, Bounds):
                found[key] = extra
    return found


def check_settings(settings: Any) -> None:
    """Check the fields of a settings dataclass against their bounds; its `__post_init__` calls it.

    Raises:
        EstimatorError: a value is out of its bounds; the text names the key.

    """
    for key, allowed in bounds_of(type(settings)).items():
        value = getattr(settings, key)
        if isinstance(allowed, Bounds):
            if not allowed.holds(value):
                raise EstimatorError(f"{key} is {value}; it must be {allowed}")
        elif value not in allowed:
            raise EstimatorError(f"{key} is {value!r}; it must be {' or '.join(map(repr, allowed))}")


def is_sound(measurement: Measurement) -> bool:
    """Return whether all numbers are finite, all sigmas above zero, a range not negative and its two ends different."""
    for one in fields(measurement):
        value = getattr(measurement, one.name)
        numbers = value if isinstance(value, tuple) else () if value is None else (value,)
        if not all(math.isfinite(number) for number in numbers):
            return False
    match measurement:
        case PositionMeasurement():
            speed_sigma = measurement.sigma_velocity_mps
            return measurement.sigma_h_m > 0.0 and measurement.sigma_v_m > 0.0 and (speed_sigma is None or speed_sigma > 0.0)
        case RangeMeasurement():
            return measurement.sigma_m > 0.0 and measurement.range_m >= 0.0 and measurement.from_vehicle != measurement.to_vehicle
        case AltitudeMeasurement():
            return measurement.sigma_m > 0.0
        case AttitudeMeasurement():
            return True
