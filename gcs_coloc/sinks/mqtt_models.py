"""The MQTT messages that are published, as models, and the topics of all messages.

docs/reference/mqtt.md describes every topic and field.
`python -m gcs_coloc.sinks.mqtt_models` prints their JSON schemas, which stand in docs/reference/schemas/mqtt-v2.json.
"""

from __future__ import annotations

import json
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from gcs_coloc.core.alarms.alarms import Alarm, AlarmKind, AlarmState
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState
from gcs_coloc.core.snapshot import FleetSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.sign_of_life import StandbyState
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.sinks.fleet_overview import FleetOverview, told
from gcs_coloc.sinks.mqtt_inbox import Command, Range, StandbyCommand

TOPIC_VERSION = "v2"
"""Stands in every topic. A change that breaks readers makes it the next one; v1 was that of version 0.1."""


class _Sent(BaseModel):
    """`at_unix_s` is when this was true, UNIX time in seconds; None where the host does not know the time."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    at_unix_s: float | None


class VehicleState(_Sent):
    """`…/{sysid}/state`: what the vehicle says of itself (`reported_*`), and what is sent to it."""

    sysid: int
    name: str
    autopilot: str
    age_s: float
    reported_lat_deg: float | None
    reported_lon_deg: float | None
    yaw_rad: float | None
    fix_type: int | None
    satellites: int | None
    aiding: str
    aiding_has_fix: bool
    fix_acknowledged: bool | None
    gps_primary: str | None
    inhibit_reason: str | None


class VehicleEstimate(_Sent):
    """`…/{sysid}/estimate`: the service's estimate of the vehicle's position.

    Where there is none, the position is None and `no_estimate_reason` says why.
    """

    sysid: int
    lat_deg: float | None
    lon_deg: float | None
    alt_msl_m: float | None
    velocity_enu_mps: tuple[float, float, float] | None
    sigma_h_m: float | None
    sigma_v_m: float | None
    bound_95_m: float | None
    hpl_m: float | None
    vpl_m: float | None
    untested: tuple[int, ...]
    hdop: float | None
    ranges_in_use: int
    no_estimate_reason: str | None
    no_estimate_code: str | None


class VehicleHealth(_Sent):
    """`…/{sysid}/health`: the state of the vehicle's GPS, and the operator's overrides.

    The state is the one that the service has decided on.
    """

    sysid: int
    gps_state: str
    gps_reason: str
    gps_override: str
    aiding_override: str
    primary_override: str
    gps_override_by: str | None
    aiding_override_by: str | None
    primary_override_by: str | None


class ReadinessTold(_Sent):
    """`…/{sysid}/readiness`: whether the vehicle would be located if its GPS failed now.

    `state` is None while its GPS is not healthy.
    """

    sysid: int
    state: ReadinessState | None
    reason: str | None
    text: str
    peers: int | None
    bound_95_now_m: float | None
    bound_95_m: float | None
    hpl_now_m: float | None
    hpl_m: float | None
    hdop_now: float | None
    hdop: float | None
    is_told: bool | None


class StationState(_Sent):
    """`…/station/{id}`: a fixed station.

    It has where the station is, whether its ranges are used, and what contradicts its position.
    """

    station_id: int
    name: str
    source: str
    lat_deg: float | None
    lon_deg: float | None
    alt_msl_m: float | None
    sigma_h_m: float | None
    sigma_v_m: float | None
    range_age_s: float | None
    fault: str | None
    is_used: bool


class StandbyStatus(BaseModel):
    """Which of the two services of a hot standby sends; ages in seconds, None for never heard."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    own: str
    state: StandbyState
    reason: str
    term: int
    sends: Literal["this", "other", "nobody", "unknown"]
    other: str | None
    other_state: StandbyState | None
    other_age_s: float | None
    problem: str | None


class FleetStatus(_Sent):
    """`…/status`: whether the service is connected.

    The broker sets `online` to false (the last will) when the connection is lost.
    """

    online: bool
    estimator: str | None
    vehicles: tuple[int, ...]
    refused: dict[str, int]
    outs: tuple[OutSnapshot, ...]
    standby: StandbyStatus | None = None


class AlarmChange(_Sent):
    """`…/alarms`: an alarm that was raised or has changed. `sysid` None: it is about the whole fleet."""

    id: int
    state: AlarmState
    kind: AlarmKind
    sysid: int | None
    level: Literal["warning", "error"]
    text: str
    action: str
    times: int
    raised_unix_s: float | None


BY_TOPIC: dict[str, type[BaseModel]] = {
    "{sysid}/state": VehicleState,
    "{sysid}/estimate": VehicleEstimate,
    "{sysid}/health": VehicleHealth,
    "{sysid}/readiness": ReadinessTold,
    "station/{id}": StationState,
    "status": FleetStatus,
    "overview": FleetOverview,
    "alarms": AlarmChange,
    "{sysid}/cmd": Command,
    "standby/cmd": StandbyCommand,
    "{sysid}/range": Range,
}
"""Every topic below `{prefix}/v2/{fleet}/`, and what is on it."""


def of_vehicle(v: VehicleSnapshot, at_unix_s: float | None) -> dict[str, _Sent]:
    """What is published of one vehicle, by the last part of its topic."""
    return {
        "state": told(VehicleState, v, at_unix_s=at_unix_s),
        "estimate": told(VehicleEstimate, v, at_unix_s=at_unix_s),
        "health": told(VehicleHealth, v, at_unix_s=at_unix_s),
        "readiness": _readiness(v, at_unix_s),
    }


def _readiness(v: VehicleSnapshot, at_unix_s: float | None) -> ReadinessTold:
    found: dict[str, Any] = {"at_unix_s": at_unix_s, "sysid": v.sysid}
    if v.readiness is None:
        return ReadinessTold.model_validate(dict.fromkeys(ReadinessTold.model_fields) | found | {"text": ""})
    return told(ReadinessTold, v.readiness, **found)


def of_station(station: StationSnapshot, at_unix_s: float | None) -> StationState:
    """What is published of one station."""
    return told(StationState, station, at_unix_s=at_unix_s)


def of_alarm(alarm: Alarm, snapshot: FleetSnapshot) -> AlarmChange:
    """What is published of an alarm that has changed; `snapshot` knows the time."""
    at_unix_s, raised_unix_s = unix_s(alarm.at_s, snapshot), unix_s(alarm.raised_at_s, snapshot)
    return told(AlarmChange, alarm, at_unix_s=at_unix_s, raised_unix_s=raised_unix_s)


def status(snapshot: FleetSnapshot | None, *, online: bool) -> FleetStatus:
    """Return the fleet's status.

    `snapshot` is None before the first one, and for the last will, which has no time.
    """
    if snapshot is None:
        return FleetStatus(at_unix_s=None, online=online, estimator=None, vehicles=(), refused={}, outs=())
    vehicles = tuple(v.sysid for v in snapshot.vehicles)
    return FleetStatus(
        at_unix_s=unix_s(snapshot.at_s, snapshot),
        online=online,
        estimator=snapshot.estimator,
        vehicles=vehicles,
        refused=snapshot.refused,
        outs=snapshot.outs,
        standby=told(StandbyStatus, snapshot.standby) if snapshot.standby is not None else None,
    )


def unix_s(at_s: float, snapshot: FleetSnapshot) -> float | None:
    """A service time as UNIX time, None where the host does not know it."""
    return at_s + snapshot.utc_minus_service_s if snapshot.utc_minus_service_s is not None else None


def schemas() -> dict[str, Any]:
    """The JSON schema of what is on each topic."""
    return {topic: model.model_json_schema() for topic, model in BY_TOPIC.items()}


if __name__ == "__main__":
    print(json.dumps(schemas(), indent=2, ensure_ascii=False))
