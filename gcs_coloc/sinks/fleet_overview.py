"""One fleet in one message: how each vehicle stands, and the alarms in the list.

A page of all fleets shows it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState, LightColour, traffic_light
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot

_MAX_VEHICLES = 255  # chosen: bounds what a page takes from a broker; `max_vehicles` of a fleet is at most 250
_MAX_ALARMS = 2000
"""Chosen: more than a fleet of 255 vehicles has in its list."""


Model = TypeVar("Model", bound=BaseModel)
_Finite = Annotated[float | None, BeforeValidator(lambda value: value if value is not None and math.isfinite(value) else None)]
"""A number that JSON can hold."""


# Fields of a newer version are passed over: a page of all fleets shows services of several versions.
class _Told(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class VehicleOverview(_Told):
    """One vehicle: its traffic light with the reason, and its position.

    The position is in degrees and metres (WGS 84), None as far as it is not known.
    """

    sysid: int
    name: str
    light: LightColour
    reason: str
    gps_state: str
    age_s: float
    lat_deg: _Finite
    lon_deg: _Finite
    alt_msl_m: _Finite
    bound_95_m: _Finite
    hpl_m: _Finite
    aiding: str
    aiding_has_fix: bool


class AlarmOverview(_Told):
    """An alarm that lasts, or that nobody has acknowledged yet; `sysid` None: it is about the whole fleet."""

    id: int
    kind: AlarmKind
    sysid: int | None
    state: AlarmState
    level: Literal["warning", "error"]
    text: str


class FleetOverview(_Told):
    """`…/overview`: the fleet in one message, for `gcs-coloc watch`.

    `at_unix_s` is when this was true, None where the host does not know the time; `at_s` is the same on the service's own clock,
    and another one in every message. The next one follows in `every_s`. `host` is the computer's name.
    """

    at_unix_s: float | None
    at_s: float
    every_s: float = Field(gt=0)
    host: str
    estimator: str
    vehicles: tuple[VehicleOverview, ...] = Field(max_length=_MAX_VEHICLES)
    alarms: tuple[AlarmOverview, ...] = Field(max_length=_MAX_ALARMS)


def fleet_overview(snapshot: FleetSnapshot, alarms: Iterable[Alarm], *, host: str, every_s: float) -> FleetOverview:
    """The message of one instant; `alarms` are those of the fleet that are not closed."""
    offset_s = snapshot.utc_minus_service_s
    return FleetOverview(
        at_unix_s=snapshot.at_s + offset_s if offset_s is not None else None,
        at_s=snapshot.at_s,
        every_s=every_s,
        host=host,
        estimator=snapshot.estimator,
        vehicles=tuple(_vehicle(v, snapshot.loop_lag_s) for v in snapshot.vehicles),
        alarms=tuple(told(AlarmOverview, alarm) for alarm in alarms),
    )


def _vehicle(v: VehicleSnapshot, loop_lag_s: float) -> VehicleOverview:
    light, reason = traffic_light(v, loop_lag_s)
    return told(VehicleOverview, v, light=light, reason=reason)


def told(model: type[Model], source: object, **further: Any) -> Model:
    """Make a message with the fields of a snapshot of the core, and some further ones."""
    return model.model_validate({key: getattr(source, key) for key in model.model_fields.keys() - further.keys()} | further)
