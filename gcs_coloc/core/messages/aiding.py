"""What passes between the service and a vehicle about its aid, besides GPS_INPUT. Conventions: `messages`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CommandResult:
    """COMMAND_ACK (77): what a vehicle made of a command; `command` is a MAV_CMD, `result` a MAV_RESULT."""

    sysid: int
    received_at_s: float
    command: int
    result: int


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """PARAM_VALUE (22): one parameter of a vehicle as it stands; `kind` is its MAV_PARAM_TYPE."""

    sysid: int
    received_at_s: float
    name: str
    value: float
    kind: int


@dataclass(frozen=True, slots=True)
class ForeignGpsInput:
    """GPS_INPUT (232) that somebody else sends: system `sysid`, for the receiver instance `gps_id`.

    The message has no target field: `vehicle` is whom it reaches, as the link layer knows; None where that is not known.
    """

    sysid: int
    received_at_s: float
    gps_id: int
    vehicle: int | None = None


@dataclass(frozen=True, slots=True)
class ExternalPosition:
    """COMMAND_INT MAV_CMD_EXTERNAL_POSITION_ESTIMATE (43003) to one vehicle: where it is when the command arrives.

    `sent_s` (param 1) is the time of sending on a clock of ours that begins near 0, `accuracy_m` (param 3) 1-sigma. The
    processing time (param 2) is 0 and the altitude NaN, as the command wants it.
    """

    sysid: int
    sent_s: float
    lat_deg: float
    lon_deg: float
    accuracy_m: float


@dataclass(frozen=True, slots=True)
class GlobalPositionSensor:
    """GLOBAL_POSITION_SENSOR (296) to one vehicle: where it is when the message arrives. `eph_m`, `epv_m` are 1-sigma."""

    sysid: int
    time_usec: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    eph_m: float
    epv_m: float


@dataclass(frozen=True, slots=True)
class ParameterRequest:
    """PARAM_REQUEST_READ (20): asks one vehicle for one parameter by its name."""

    sysid: int
    name: str


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """PARAM_SET (23): changes one parameter of one vehicle; it answers with PARAM_VALUE. `kind` is a MAV_PARAM_TYPE."""

    sysid: int
    name: str
    value: float
    kind: int
