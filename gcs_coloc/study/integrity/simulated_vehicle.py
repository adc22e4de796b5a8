"""One simulated vehicle of a trial: its receiver, its autopilot and the messages they send."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

import numpy as np

from gcs_coloc.core.measurements import Vector3, VehicleClass
from gcs_coloc.core.messages.control import RouteReport
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    Autopilot,
    EkfStatus,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Inbound,
    SystemHealth,
    SystemTime,
)
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.study.integrity.flight_classes import FlightClass
from gcs_coloc.study.integrity.motion import Trajectory
from gcs_coloc.study.integrity.sensor_errors import (
    BarometerJump,
    Fault,
    Intervals,
    LinkErrors,
    PitotFailure,
    ReceiverErrors,
    is_within,
    scaled,
)
from sitl_fakes.geodesy import WorldFrame

UNIX_EPOCH_S = 1_780_000_000.0  # any; in 2026
_AID_AGE_S = 0.1
"""Age that a vehicle takes a fix of ours to have: the default of `aiding.lag_s`."""
_DOPPLER_MPS, _DOPPLER_STATED_MPS = 0.1, 0.3
"""Error of a receiver's own velocity, and what it states for it; source: data sheets of receivers, 0.05 to 0.1 m/s."""
_AID_FRESH_S = 1.0  # chosen: ten messages of 10 Hz
_FLIES_ON_S = 10.0
"""For so long an EKF without position calls itself absolute. Source: EKF3 with airspeed; copters less."""

_NOWHERE: Vector3 = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class SimulatedVehicle:
    """One vehicle: its motion and errors, faults, and the last fix that it was sent (when, ENU m, m/s).

    `frame`: that of its motion. `drawn`: the class that it is drawn from. While `frozen` it repeats its last `angles_rad`.
    """

    sysid: int
    frame: WorldFrame
    rng: np.random.Generator
    drawn: FlightClass
    course: Trajectory
    receiver: ReceiverErrors
    link: LinkErrors
    reckoning_mps: Vector3
    fault: Fault | None = None
    pitot_failure: PitotFailure | None = None
    barometer_jump: BarometerJump | None = None
    frozen: Intervals = field(default_factory=list)
    angles_rad: Vector3 | None = None
    lost_at_s: float = inf
    flicker: list[tuple[float, float, Vector3]] | None = None
    aid: tuple[float, Vector3, Vector3] | None = None

    def has_fix(self, at_s: float) -> bool:
        """Whether its own receiver has a fix."""
        return at_s < self.lost_at_s or any(start <= at_s < end for start, end, _ in self.flicker or ())

    def false_m(self, at_s: float) -> Vector3:
        """Return the false offset of its receiver."""
        offset = self.fault.offset_m(at_s) if self.fault is not None else _NOWHERE
        for start, end, flicker_m in self.flicker or ():
            if start <= at_s < end:
                offset = _plus(offset, flicker_m)
        return offset

    def refuses_receiver(self, at_s: float) -> bool:
        """Whether its autopilot still refuses a step of its receiver."""
        return self.fault is not None and self.fault.at_s <= at_s < self.fault.at_s + self.fault.followed_after_s

    def is_aided(self, at_s: float) -> bool:
        """Whether it flies on a fix that it was sent."""
        return self.aid is not None and at_s - self.aid[0] < _AID_FRESH_S and not self.has_fix(at_s)

    def arrival_s(self, at_s: float) -> float:
        """Return when what it sends at a time is received.

        What arrives before the service's start waits for it.
        """
        return max(self.link.arrival_s(at_s), self.drawn.backlog_s)

    def set_aid(self, sent: GpsInput, at_s: float) -> None:
        """Let it have a fix that it was sent."""
        if sent.fix_type >= 3:
            place = self.frame.to_enu(sent.lat_deg, sent.lon_deg, sent.alt_msl_m)
            self.aid = (at_s, place, (sent.ve_mps, sent.vn_mps, -sent.vd_mps))

    def _white(self) -> Vector3:
        """Draw three values of white noise of unit variance."""
        x, y, z = self.rng.standard_normal(3).tolist()
        return x, y, z

    def heartbeat_messages(self, at_s: float) -> list[Inbound]:
        """Build the heartbeat, and what the link layer knows of the route."""
        arrival_s, sysid = self.arrival_s(at_s), self.sysid
        winged = self.course.airspeed_mps is not None
        vehicle_class = VehicleClass.PLANE if winged else VehicleClass.MULTIROTOR
        heartbeat = Heartbeat(sysid, arrival_s, Autopilot.ARDUPILOT, True, winged, vehicle_class=vehicle_class)
        return [heartbeat, RouteReport(sysid, arrival_s, None)]

    def receiver_messages(self, at_s: float) -> list[Inbound]:
        """Build what its own receiver states, and the receiver that we feed."""
        arrival_s, boot_s, errors = self.arrival_s(at_s), self.link.boot_s(at_s), self.receiver
        sysid, stated_m, vertical_m = self.sysid, errors.stated_m, errors.stated_vertical_m
        if self.has_fix(at_s):
            noise_m = scaled(errors.white_m, self._white())
            place = _plus(_plus(self.course.position(at_s), errors.slow_m(at_s)), noise_m)
            lla = self._stated(place, self.false_m(at_s))
            own = GpsReceiver(
                *(sysid, arrival_s, 0, 3, *lla, 14, 0.8, stated_m, vertical_m, _DOPPLER_STATED_MPS, boot_s),
                velocity_ne_mps=self._doppler_ne_mps(at_s),
            )
        else:
            own = GpsReceiver(sysid, arrival_s, 0, 1, 0.0, 0.0, 0.0, 2, None, stated_m, vertical_m, 0.3, boot_s)
        aid = self.aid
        if aid is None or at_s - aid[0] >= _AID_FRESH_S:
            return [own]
        return [own, GpsReceiver(sysid, arrival_s, 1, 3, *self.frame.to_lla(*aid[1]), 10, 1.0, 1.0, 1.0, 0.5, boot_s)]

    def _stated(self, place: Vector3, false_m: Vector3) -> Vector3:
        """Return latitude, longitude (degrees) and altitude (m) of a place displaced along the earth."""
        lat, lon, alt = self.frame.to_lla(*_plus(place, false_m))
        return lat, lon, alt if false_m == _NOWHERE else self.frame.to_lla(*place)[2]

    def _doppler_ne_mps(self, at_s: float) -> tuple[float, float]:
        false_mps = self.fault.doppler_mps(at_s) if self.fault is not None else _NOWHERE
        noise_mps = scaled(_DOPPLER_MPS, self._white())
        east_mps, north_mps, _ = _plus(_plus(self.course.velocity(at_s), false_mps), noise_mps)
        return north_mps, east_mps

    def position_messages(self, at_s: float) -> list[Inbound]:
        """Build the position that its autopilot reports.

        It comes from its receiver, from the fix that it was sent, or from dead reckoning.
        """
        arrival_s, errors, course = self.arrival_s(at_s), self.receiver, self.course
        true_m, velocity_mps = course.position(at_s), _plus(course.velocity(at_s), errors.velocity_mps(at_s))
        place, false_m = _plus(true_m, errors.slow_m(at_s)), _NOWHERE
        if self.is_aided(at_s) and self.aid is not None:
            heard_s, fix_m, velocity_mps = self.aid
            place = _plus(fix_m, scaled(at_s - heard_s + _AID_AGE_S, velocity_mps))
        elif not self.has_fix(at_s):
            lost_s = max(at_s - self.lost_at_s, 0.0)
            place, velocity_mps = _plus(place, scaled(lost_s, self.reckoning_mps)), _plus(velocity_mps, self.reckoning_mps)
        elif not self.refuses_receiver(at_s):
            false_m = self.false_m(at_s)
            if not self.drawn.filters_positions:
                place = _plus(place, scaled(errors.white_m, self._white()))
            if self.fault is not None and at_s >= self.fault.at_s:
                velocity_mps = _plus(velocity_mps, scaled(self.fault.ramp_mps, self.fault.away))
        jump_m = self.barometer_jump.offset_m(at_s) if self.barometer_jump is not None else 0.0
        lat, lon, alt = self._stated((place[0], place[1], true_m[2] + errors.height_m(at_s) + jump_m), false_m)
        if self.lost_at_s < 0.0 and not self.is_aided(at_s):
            lat, lon = 0.0, 0.0  # as ArduPilot reports without an origin
        ve, vn, vu = velocity_mps
        boot_s = self.link.boot_s(at_s)
        return [GlobalPosition(self.sysid, arrival_s, boot_s, lat, lon, alt, vn, ve, -vu)]

    def attitude_messages(self, at_s: float) -> list[Inbound]:
        """Build its attitude."""
        arrival_s = self.arrival_s(at_s)
        if self.angles_rad is None or not is_within(self.frozen, at_s):
            roll, pitch, yaw = _plus(self.course.attitude(at_s), scaled(0.015, self._white()))
            self.angles_rad = roll, pitch, yaw + self.receiver.heading_rad
        return [Attitude(self.sysid, arrival_s, self.link.boot_s(at_s), *self.angles_rad)]

    def airspeed_messages(self, at_s: float) -> list[Inbound]:
        """Build its airspeed; nothing of a vehicle without wings."""
        true_mps = self.course.airspeed(at_s)
        if true_mps is None:
            return []
        arrival_s = self.arrival_s(at_s)
        # Indicated airspeed, by the density of the standard atmosphere at the flight's altitude.
        altitude_m = self.frame.to_lla(*self.course.position(at_s))[2]
        indicated_mps = true_mps * (1.0 - 2.25577e-5 * max(altitude_m, 0.0)) ** 2.128 * self.receiver.pitot
        indicated_mps += float(0.4 * self.rng.standard_normal())
        if self.pitot_failure is not None:
            indicated_mps = self.pitot_failure.reads_mps(indicated_mps, at_s)
        return [Airspeed(self.sysid, arrival_s, max(indicated_mps, 0.0))]

    def health_messages(self, at_s: float) -> list[Inbound]:
        """Build the GPS bit of its SYS_STATUS."""
        arrival_s, is_good = self.arrival_s(at_s), self.has_fix(at_s) or self.is_aided(at_s)
        return [SystemHealth(self.sysid, arrival_s, True, True, is_good)]

    def ekf_messages(self, at_s: float) -> list[Inbound]:
        """Build the flags of its EKF."""
        arrival_s = self.arrival_s(at_s)
        flies = self.has_fix(at_s) or self.is_aided(at_s) or 0.0 <= at_s - self.lost_at_s < _FLIES_ON_S
        return [EkfStatus(self.sysid, arrival_s, flies, False, self.refuses_receiver(at_s))]

    def system_time_messages(self, at_s: float) -> list[Inbound]:
        """Build its UTC."""
        arrival_s = self.arrival_s(at_s)
        unix_s = UNIX_EPOCH_S + at_s - self.receiver.utc_behind_s
        return [SystemTime(self.sysid, arrival_s, self.link.boot_s(at_s), unix_s)]


def _plus(a: Vector3, b: Vector3) -> Vector3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
