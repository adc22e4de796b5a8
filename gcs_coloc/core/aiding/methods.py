"""The ways to aid a vehicle behind one interface, GPS_INPUT and GLOBAL_POSITION_SENSOR.

All take the same answer of the estimator, under the same policy. Only GPS_INPUT can say that there is no fix; the others fall
silent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Protocol

from gcs_coloc.core.aiding.gps_input import gps_input, no_fix
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.aiding import CommandResult, GlobalPositionSensor
from gcs_coloc.core.messages.outbound import AidingMessage, Notice
from gcs_coloc.core.telemetry.vehicles import Vehicle


@dataclass(frozen=True, slots=True)
class Moment:
    """What is to be told at one time. Times are on the service's clock.

    `where` is the answer for the time that the way's `age_s` asks for, `arrives_s` when what is sent now arrives,
    `fix_inhibit_reason` the policy's; `locate` answers for other times. `standby`: the vehicle's own receiver is in use.
    `on_air`: what is told is sent, so that an answer may be expected.
    """

    now_s: float
    arrives_s: float
    frame: LocalFrame | None
    utc_minus_service_s: float | None
    where: Estimate | NoEstimate
    fix_inhibit_reason: str | None
    locate: Callable[[float], Estimate | NoEstimate]
    standby: bool
    on_air: bool = True

    def unix_us(self, at_s: float) -> int:
        """A service time as UNIX time in microseconds, 0 where that is not known."""
        return round((at_s + self.utc_minus_service_s) * 1e6) if self.utc_minus_service_s is not None else 0


class AidingMethod(Protocol):
    """One way to tell one vehicle where it is. `age_s`: how old it takes the position to be when the message arrives."""

    age_s: float

    def tell(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """The messages that are due now, called `rate_hz` times a second."""

    def end(self) -> Sequence[AidingMessage]:
        """The last messages, after which nothing comes."""

    def answered(self, result: CommandResult) -> Sequence[Notice]:
        """Take the vehicle's answer to a command."""

    def sends(self) -> str:
        """What is sent while there is a fix, in words."""

    def sends_without_fix(self) -> str:
        """What is sent while there is none, in words."""


class GpsInputMethod:
    """GPS_INPUT, the position of `lag_s` ago."""

    def __init__(self, vehicle: Vehicle, settings: AidingSettings) -> None:
        self.age_s = settings.lag_s
        self._vehicle = vehicle
        self._settings = settings

    def tell(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says: one GPS_INPUT, with a fix or without."""
        at_s, utc = moment.arrives_s - self.age_s, moment.utc_minus_service_s
        unix_s = at_s + utc if utc is not None else None
        where = moment.where if moment.fix_inhibit_reason is None and isinstance(moment.where, Estimate) else None
        return [gps_input(self._vehicle.sysid, where, moment.frame, self._vehicle.range_error_m, unix_s, self._settings.gps_id)]

    def end(self) -> Sequence[AidingMessage]:
        """As the protocol says: no fix."""
        return [no_fix(self._vehicle.sysid, self._settings.gps_id)]

    def answered(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says: no command is sent."""
        del result
        return []

    def sends(self) -> str:
        """As the protocol says."""
        return "3D fix"

    def sends_without_fix(self) -> str:
        """As the protocol says."""
        return "no fix"


class GlobalPositionSensorMethod:
    """GLOBAL_POSITION_SENSOR, which PX4 stamps when it arrives."""

    age_s = 0.0

    def __init__(self, vehicle: Vehicle) -> None:
        self._sysid = vehicle.sysid

    def tell(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        where, frame = moment.where, moment.frame
        if moment.fix_inhibit_reason is not None or isinstance(where, NoEstimate) or frame is None:
            return []
        lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        eph_m, epv_m = horizontal_sigma_m(where.covariance), sqrt(float(where.covariance[2, 2]))
        return [GlobalPositionSensor(self._sysid, moment.unix_us(moment.now_s), lat_deg, lon_deg, alt_msl_m, eph_m, epv_m)]

    def end(self) -> Sequence[AidingMessage]:
        """As the protocol says: the message cannot say that there is no position."""
        return []

    def answered(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says: no command is sent."""
        del result
        return []

    def sends(self) -> str:
        """As the protocol says."""
        return "GLOBAL_POSITION_SENSOR"

    def sends_without_fix(self) -> str:
        """As the protocol says."""
        return "nothing"
