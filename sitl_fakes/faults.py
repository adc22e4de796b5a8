"""Faults of a scenario or of a command: one model per kind, distinguished by `kind`.

Times are seconds since the start.

A fault without `until_s` stays. Headings are degrees from north, clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

from sitl_fakes.parameters import Parameters

_METRES_PER_DEGREE = 111_319.49  # source: WGS 84, at the equator
_HARMLESS = {"SIM_GPS1_ENABLE": 1.0, "SIM_GPS1_JAM": 0.0, "SIM_GPS1_GLTCH_X": 0.0, "SIM_GPS1_GLTCH_Y": 0.0}

_SystemId = Annotated[int, Field(ge=1, le=254)]


class _Fault(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    vehicle: _SystemId
    at_s: float = Field(ge=0.0)
    until_s: float | None = None

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> Self:
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError("until_s must be later than at_s")
        return self

    def active(self, at_s: float) -> bool:
        """Whether the fault holds at a time (s since the start)."""
        return self.at_s <= at_s and (self.until_s is None or at_s < self.until_s)


class GpsLost(_Fault):
    """The vehicle's own receiver loses its fix."""

    kind: Literal["gps_lost"] = "gps_lost"


class GpsJammed(_Fault):
    """The vehicle's own receiver flickers between fix and none and reports positions that wander off.

    `reported`: it notices, and a PX4 says so in GNSS_INTEGRITY.
    """

    kind: Literal["gps_jammed"] = "gps_jammed"
    reported: bool = False


class GpsFrozen(_Fault):
    """The vehicle's own receiver repeats its last fix as if it were new."""

    kind: Literal["gps_frozen"] = "gps_frozen"


class GpsSpoofed(_Fault):
    """The vehicle's own receiver is walked off, with all its signs of health.

    It moves at `speed_mps` towards `direction_deg`. A `speed_mps` of 0 with an `offset_m` is a step. `reported`: the receiver
    notices, and a PX4 says so in GNSS_INTEGRITY. `velocity_follows`: its velocity is in keeping; else it is the true one, as in
    ArduPilot's SITL.
    """

    kind: Literal["gps_spoofed"] = "gps_spoofed"
    reported: bool = False
    velocity_follows: bool = True
    direction_deg: float = 90.0
    speed_mps: float = Field(default=2.0, ge=0.0, le=1e3)
    offset_m: float = Field(default=0.0, ge=0.0, le=1e6)


class RangeDropout(_Fault):
    """Ranges that the vehicle measures (to `peer`, or to all) are not sent."""

    kind: Literal["range_dropout"] = "range_dropout"
    peer: _SystemId | None = None


class RangeBias(_Fault):
    """Ranges that the vehicle measures (to `peer`, or to all) are off by `bias_m`."""

    kind: Literal["range_bias"] = "range_bias"
    peer: _SystemId | None = None
    bias_m: float = Field(ge=-1e6, le=1e6)


class RangeStuck(_Fault):
    """Ranges that the vehicle measures repeat the last value, with new times and numbers.

    They are those to `peer`, or to all.
    """

    kind: Literal["range_stuck"] = "range_stuck"
    peer: _SystemId | None = None


class LinkDropout(_Fault):
    """The vehicle's telemetry link is dead in both directions."""

    kind: Literal["link_dropout"] = "link_dropout"


class _Momentary(_Fault):
    @model_validator(mode="after")
    def _does_not_last(self) -> Self:
        if self.until_s is not None:
            raise ValueError("what happens at once takes no until_s")
        return self


class Reboot(_Momentary):
    """The autopilot restarts in flight.

    It is silent while it boots; then its boot clock is from zero and it has no memory but its parameters.
    """

    kind: Literal["reboot"] = "reboot"


class ClockJump(_Momentary):
    """The autopilot's boot clock steps by `by_s`, forwards or back, without a reboot."""

    kind: Literal["clock_jump"] = "clock_jump"
    by_s: float = Field(ge=-1e6, le=1e6)


Fault = GpsLost | GpsJammed | GpsFrozen | GpsSpoofed | RangeDropout | RangeBias | RangeStuck | LinkDropout | Reboot | ClockJump
AnyFault = Annotated[Fault, Field(discriminator="kind")]


def fault_of_command(sysid: int, params: list[float], at_s: float) -> Fault | None:
    """The fault that COMMAND_LONG MAV_CMD_USER_1 (31010) requests, None where no such fault exists.

    `params[0]`: 1 GPS lost, 2 jammed, 3 frozen, 4 spoofed (params[1] direction in deg, [2] m/s, [3] step in m), 5 ranges
    dropped, 6 biased by params[2] m, 7 stuck (params[1] the peer, 0 all), 8 link dead, 9 reboot, 10 clock jump by params[2] s.
    `params[6]`: duration, s; 0 without end (refused for a dead link, which no command could end). Raises ValueError or
    OverflowError where a number is not finite, or impossible for such a fault.
    """
    number, second, third, fourth = params[:4]
    lasts_s = params[6] or None
    if number not in range(1, len(get_args(Fault)) + 1):
        return None
    model = get_args(Fault)[int(number) - 1]
    if model is LinkDropout and lasts_s is None:
        return None
    said: dict[str, Any] = {"vehicle": sysid, "at_s": at_s, "direction_deg": second, "speed_mps": third, "offset_m": fourth}
    said |= {"bias_m": third, "by_s": third}
    if lasts_s is not None and not issubclass(model, _Momentary):
        said["until_s"] = at_s + lasts_s
    if "peer" in model.model_fields:
        said["peer"] = int(second) or None
    fault: Fault = model(**{name: value for name, value in said.items() if name in model.model_fields})
    return fault


class ActiveFaults:
    """The faults of one vehicle. `origin_lat_deg` turns a glitch in degrees of longitude into metres."""

    def __init__(self, sysid: int, faults: Iterable[Fault], params: Parameters, origin_lat_deg: float) -> None:
        self._sysid = sysid
        self._faults = [f for f in faults if f.vehicle == sysid]
        self._params = params
        self._east_m_per_deg = _METRES_PER_DEGREE * math.cos(math.radians(origin_lat_deg))

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        self._faults.append(fault)

    def remove(self, fault: Fault) -> None:
        """Remove a fault that has had its effect."""
        self._faults.remove(fault)

    def clear(self, at_s: float) -> None:
        """End every fault in force, also by parameter; those to come stay."""
        self._faults = [f for f in self._faults if not f.active(at_s)]
        for name, harmless in _HARMLESS.items():
            if name in self._params:
                self._params.set(name, harmless)

    def active(self, at_s: float) -> list[Fault]:
        """Faults in force at a time (s)."""
        active = [f for f in self._faults if f.active(at_s)]
        simulated = {name: self._params.get(name, harmless) for name, harmless in _HARMLESS.items()}
        if simulated["SIM_GPS1_ENABLE"] == 0:
            active.append(GpsLost(vehicle=self._sysid, at_s=at_s))
        if simulated["SIM_GPS1_JAM"] != 0:
            active.append(GpsJammed(vehicle=self._sysid, at_s=at_s))
        north = simulated["SIM_GPS1_GLTCH_X"] * _METRES_PER_DEGREE
        east = simulated["SIM_GPS1_GLTCH_Y"] * self._east_m_per_deg
        if east != 0.0 or north != 0.0:
            direction, step = math.degrees(math.atan2(east, north)), math.hypot(east, north)
            active.append(GpsSpoofed(vehicle=self._sysid, at_s=at_s, direction_deg=direction, speed_mps=0.0, offset_m=step))
        return active
