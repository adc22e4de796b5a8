"""One fleet in one message: how each vehicle stands, and the alarms in the list.

A page of all fleets shows it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState, LightColour, traffic_light
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot

_MAX_VEHICLES = 255  # chosen: bounds what a page takes from a broker; `max_vehicles` of a fleet is at most 250
_MAX_ALARMS = 2000
"""Chosen: more than a fleet of 255 vehicles has in its list."""


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
    lat_deg: float | None
    lon_deg: float | None
    alt_msl_m: float | None
    bound_95_m: float | None
    hpl_m: float | None
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
        alarms=tuple(
            AlarmOverview.model_validate({key: getattr(alarm, key) for key in AlarmOverview.model_fields}) for alarm in alarms
        ),
    )


def _vehicle(v: VehicleSnapshot, loop_lag_s: float) -> VehicleOverview:
    light, reason = traffic_light(v, loop_lag_s)
    return VehicleOverview(
        sysid=v.sysid,
        name=v.name,
        light=light,
        reason=reason,
        gps_state=v.gps_state,
        age_s=v.age_s,
        lat_deg=_finite(v.lat_deg),
        lon_deg=_finite(v.lon_deg),
        alt_msl_m=_finite(v.alt_msl_m),
        bound_95_m=_finite(v.bound_95_m),
        hpl_m=_finite(v.hpl_m),
        aiding=v.aiding,
        aiding_has_fix=v.aiding_has_fix,
    )


def _finite(value: float | None) -> float | None:
    """A number that JSON can hold."""
    return value if value is not None and math.isfinite(value) else None
