"""Whether a PX4 vehicle's parameters let it take GLOBAL_POSITION_SENSOR as an auxiliary global position."""

from __future__ import annotations

from collections.abc import Iterator

from gcs_coloc.doctor import parameters as p
from gcs_coloc.doctor.finding import Finding, Severity, VehicleSurvey
from gcs_coloc.doctor.parameters import ParameterRule, apply_rules, equals
from gcs_coloc.mavlink.encoder import SENSOR_ID

_HORIZONTAL = 1  # bit of EKF2_AGP_CTRL: the horizontal position is fused

_RULES = (
    ParameterRule(
        p.AGP_CONTROL,
        lambda value: bool(int(value) & _HORIZONTAL),
        Severity.STOP,
        "it does not take GLOBAL_POSITION_SENSOR",
        set_to=lambda value: float(int(value) | _HORIZONTAL),
        good="it takes GLOBAL_POSITION_SENSOR as an auxiliary global position",
        unreadable="its firmware takes no auxiliary global position",
    ),
    ParameterRule(
        p.AGP_ID, equals(SENSOR_ID), Severity.STOP, "it waits for another sensor id than ours", set_to=float(SENSOR_ID)
    ),
)


def check(vehicle: VehicleSurvey) -> Iterator[Finding]:
    """Judge the parameters that the vehicle told. Values and meanings: PX4's parameter reference, EKF2."""
    yield from apply_rules(vehicle.parameters, _RULES)
