"""What can go wrong in a scenario, and when: one model per kind, told apart by `kind`. Times are seconds since the start.

A fault without `until_s` stays. Headings are degrees from north, clockwise.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

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
    """The vehicle's own receiver flickers between fix and none and reports positions that wander off."""

    kind: Literal["gps_jammed"] = "gps_jammed"


class GpsFrozen(_Fault):
    """The vehicle's own receiver repeats its last fix as if it were new."""

    kind: Literal["gps_frozen"] = "gps_frozen"


class GpsSpoofed(_Fault):
    """The vehicle's own receiver is walked off at `speed_mps` towards `direction_deg`, with all its signs of health.

    A `speed_mps` of 0 with an `offset_m` is a step.
    """

    kind: Literal["gps_spoofed"] = "gps_spoofed"
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
    """Ranges that the vehicle measures (to `peer`, or to all) repeat the last value, with new times and numbers."""

    kind: Literal["range_stuck"] = "range_stuck"
    peer: _SystemId | None = None


class LinkDropout(_Fault):
    """The vehicle's telemetry link is dead in both directions."""

    kind: Literal["link_dropout"] = "link_dropout"


class Reboot(_Fault):
    """The autopilot restarts in flight: silent while it boots, then a boot clock from zero and no memory but its parameters."""

    kind: Literal["reboot"] = "reboot"

    @model_validator(mode="after")
    def _is_momentary(self) -> Self:
        if self.until_s is not None:
            raise ValueError("a reboot takes no until_s")
        return self


class ClockJump(_Fault):
    """The autopilot's boot clock steps by `by_s`, forwards or back, without a reboot."""

    kind: Literal["clock_jump"] = "clock_jump"
    by_s: float = Field(ge=-1e6, le=1e6)

    @model_validator(mode="after")
    def _is_momentary(self) -> Self:
        if self.until_s is not None:
            raise ValueError("a clock jump takes no until_s")
        return self


Fault = GpsLost | GpsJammed | GpsFrozen | GpsSpoofed | RangeDropout | RangeBias | RangeStuck | LinkDropout | Reboot | ClockJump
AnyFault = Annotated[Fault, Field(discriminator="kind")]
