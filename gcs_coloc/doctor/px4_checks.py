"""Whether a PX4 vehicle's parameters let it take GLOBAL_POSITION_SENSOR as an auxiliary global position."""

from __future__ import annotations

from collections.abc import Iterator

from gcs_coloc.doctor import parameters as p
from gcs_coloc.doctor.finding import Finding, VehicleSurvey, right, stop
from gcs_coloc.doctor.parameters import look_up
from gcs_coloc.mavlink.encoder import SENSOR_ID

_HORIZONTAL = 1


def check(vehicle: VehicleSurvey) -> Iterator[Finding]:
    """Judge the parameters that the vehicle told."""
    control = look_up(vehicle.parameters, p.AGP_CONTROL)
    if control is None:
        yield stop(
            f"{' or '.join(p.AGP_CONTROL)} could not be read",
            "run the doctor again, nearer to the vehicle; else its firmware takes no auxiliary global position",
        )
        return
    name, value = control
    if int(value) & _HORIZONTAL:
        yield right(f"{name} = {value:g}: it takes GLOBAL_POSITION_SENSOR as an auxiliary global position")
    else:
        wanted = float(int(value) | _HORIZONTAL)
        yield stop(f"{name} = {value:g}: it does not take GLOBAL_POSITION_SENSOR", f"set {name} = {wanted:g}", (name, wanted))
    number = look_up(vehicle.parameters, p.AGP_ID)
    if number is not None and number[1] != SENSOR_ID:
        yield stop(
            f"{number[0]} = {number[1]:g}: it waits for another sensor id than ours",
            f"set {number[0]} = {SENSOR_ID}",
            (number[0], float(SENSOR_ID)),
        )
