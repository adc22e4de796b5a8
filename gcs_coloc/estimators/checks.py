"""Whether a measurement's values can be true at all."""

from __future__ import annotations

import math
from dataclasses import fields

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)


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
