"""Validation of what an estimator is given: the values of measurements, and the bounds of settings."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.core.setting_bounds import Bounds


def bounds_of(settings_type: type[Any]) -> dict[str, Bounds | tuple[object, ...]]:
    """Return the bounds of each number of a settings dataclass, and the possible values of each Literal."""
    found: dict[str, Bounds | tuple[object, ...]] = {}
    for key, hint in get_type_hints(settings_type, include_extras=True).items():
        if get_origin(hint) is Literal:
            found[key] = get_args(hint)
        for extra in getattr(hint, "__metadata__", ()):
            if isinstance(extra, Bounds):
                found[key] = extra
    return found


def check_settings(settings: Any) -> None:
    """Check the fields of a settings dataclass against their bounds; its `__post_init__` calls it.

    Raises:
        ValueError: a value is out of its bounds; the text names the key.

    """
    for key, allowed in bounds_of(type(settings)).items():
        value = getattr(settings, key)
        if not isinstance(allowed, Bounds):
            if value not in allowed:
                raise ValueError(f"{key} = {value!r}: it must be {' or '.join(map(repr, allowed))}")
        elif not allowed.admit(value):
            raise ValueError(f"{key} = {value!r}: it must be {allowed}")


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
