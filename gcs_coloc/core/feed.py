"""From messages to measurements: frame, time and noise of everything that an estimator is fed with.

The rule that matters most stands here: a vehicle's own position becomes a PositionMeasurement only while its GPS is
HEALTHY. Of any other vehicle only the barometric altitude, the attitude and the airspeed are evidence.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import hypot

from gcs_coloc.core.fleet import Vehicle
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.health import GpsState
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.core.messages import Attitude, GlobalPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.core.timing import SenderClock

_AIRSPEED_FRESH_S = 1.0
_RANGE_CLOCKS_PER_VEHICLE = 16
_RANGE_ERROR_GAIN = 0.1


@dataclass(frozen=True, slots=True)
class FeedSettings:
    """Noise that the wire does not tell, and how old a message may be. Sigmas are one standard deviation per axis.

    `position_sigma_h_m`, `position_sigma_v_m`, `velocity_sigma_mps`: for receivers that state no accuracy.
    `least_position_sigma_m`: no receiver is believed to be better than this.
    `range_sigma_m`: for ranges that come without one. `altitude_sigma_m`: of the barometric height.
    `oldest_s`: a message measured longer ago than this is refused.
    """

    position_sigma_h_m: float = 5.0
    position_sigma_v_m: float = 8.0
    velocity_sigma_mps: float = 0.5
    least_position_sigma_m: float = 0.3
    range_sigma_m: float = 5.0
    altitude_sigma_m: float = 2.0
    oldest_s: float = 5.0


class Feed:
    """Turns the messages of one fleet into measurements about its origin. Refusals are counted by reason in `refused`."""

    def __init__(self, settings: FeedSettings) -> None:
        self.settings = settings
        self.frame: LocalFrame | None = None
        self.refused: Counter[str] = Counter()

    def position(self, message: GlobalPosition, vehicle: Vehicle) -> Measurement | None:
        """The position of a healthy vehicle, the barometric altitude of any other; sets the origin with the first fix."""
        measured_at_s = self._on_service_clock(vehicle.clock, message.boot_s, message.received_at_s, "GLOBAL_POSITION_INT")
        if measured_at_s is None:
            return None
        if vehicle.health.state is not GpsState.HEALTHY:
            return self._altitude(message, vehicle, measured_at_s)
        if self.frame is None:
            self.frame = LocalFrame(message.lat_deg, message.lon_deg, message.alt_msl_m)
        ned = (message.vn_mps, message.ve_mps, message.vd_mps)
        sigma_h_m, sigma_v_m, sigma_velocity_mps = self._accuracy(vehicle.receiver)
        return PositionMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured_at_s,
            arrived_at_s=message.received_at_s,
            position_enu_m=self.frame.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m),
            sigma_h_m=sigma_h_m,
            sigma_v_m=sigma_v_m,
            velocity_enu_mps=self.frame.enu_from_ned_velocity(message.lat_deg, message.lon_deg, ned),
            sigma_velocity_mps=sigma_velocity_mps,
        )

    def attitude(self, message: Attitude, vehicle: Vehicle) -> AttitudeMeasurement | None:
        """Attitude with the airspeed that was heard last, if that is fresh."""
        measured_at_s = self._on_service_clock(vehicle.clock, message.boot_s, message.received_at_s, "ATTITUDE")
        if measured_at_s is None:
            return None
        air = vehicle.airspeed
        fresh = air is not None and message.received_at_s - air.received_at_s <= _AIRSPEED_FRESH_S
        return AttitudeMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured_at_s,
            arrived_at_s=message.received_at_s,
            roll_rad=message.roll_rad,
            pitch_rad=message.pitch_rad,
            yaw_rad=message.yaw_rad,
            airspeed_mps=air.airspeed_mps if air is not None and fresh else None,
        )

    def range(self, message: PeerRange, vehicle: Vehicle, peer: Vehicle | None) -> RangeMeasurement | None:
        """A range between two vehicles of the fleet; `peer` is None where the other end was never heard."""
        if peer is None:
            self.refused["range: peer is not a vehicle that was heard"] += 1
            return None
        measured_at_s = self._range_time(message, vehicle)
        if measured_at_s is None:
            return None
        sigma_m = message.sigma_m if message.sigma_m is not None else self.settings.range_sigma_m
        error_m = hypot(sigma_m, self._accuracy(peer.receiver)[0])
        before_m = vehicle.range_error_m if vehicle.range_error_m is not None else error_m
        vehicle.range_error_m = before_m + _RANGE_ERROR_GAIN * (error_m - before_m)
        return RangeMeasurement(
            from_vehicle=message.sysid,
            to_vehicle=message.peer_sysid,
            measured_at_s=measured_at_s,
            arrived_at_s=message.received_at_s,
            range_m=message.range_m,
            sigma_m=sigma_m,
            device_id=message.device_id,
        )

    def up_m(self, alt_msl_m: float, near_enu_m: tuple[float, float]) -> float:
        """The up coordinate of an altitude over a place (east, north) in the frame. Only where there is a frame."""
        assert self.frame is not None
        return self.frame.up_from_height(near_enu_m[0], near_enu_m[1], alt_msl_m)

    def _altitude(self, message: GlobalPosition, vehicle: Vehicle, measured_at_s: float) -> AltitudeMeasurement | None:
        if self.frame is None:
            return None
        where = vehicle.last_known_enu_m
        return AltitudeMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured_at_s,
            arrived_at_s=message.received_at_s,
            up_m=self.up_m(message.alt_msl_m, where if where is not None else (0.0, 0.0)),
            sigma_m=self.settings.altitude_sigma_m,
        )

    def _accuracy(self, receiver: GpsReceiver | None) -> tuple[float, float, float]:
        s = self.settings
        stated_h = receiver.h_acc_m if receiver is not None else None
        stated_v = receiver.v_acc_m if receiver is not None else None
        stated_speed = receiver.speed_acc_mps if receiver is not None else None
        sigma_h_m = max(stated_h, s.least_position_sigma_m) if stated_h is not None else s.position_sigma_h_m
        sigma_v_m = max(stated_v, s.least_position_sigma_m) if stated_v is not None else s.position_sigma_v_m
        return sigma_h_m, sigma_v_m, stated_speed if stated_speed is not None else s.velocity_sigma_mps

    def _range_time(self, message: PeerRange, vehicle: Vehicle) -> float | None:
        if message.measured_at_s is None:
            return message.received_at_s
        if message.time_base is TimeBase.SERVICE:
            return self._fresh(message.measured_at_s, message.received_at_s, "range")
        # A ranging device or companion computer may have booted apart from the autopilot.
        key = (message.time_base, message.device_id)
        clock = vehicle.range_clocks.get(key)
        if clock is None:
            if len(vehicle.range_clocks) >= _RANGE_CLOCKS_PER_VEHICLE:
                self.refused["range: more clocks than a vehicle may have"] += 1
                return None
            clock = vehicle.range_clocks[key] = SenderClock()
        return self._on_service_clock(clock, message.measured_at_s, message.received_at_s, "range")

    def _on_service_clock(self, clock: SenderClock, stamp_s: float, received_at_s: float, what: str) -> float | None:
        if not clock.learn(stamp_s, received_at_s):
            self.refused[f"{what}: its clock jumped"] += 1
            return None
        return self._fresh(clock.to_service(stamp_s), received_at_s, what)

    def _fresh(self, measured_at_s: float, received_at_s: float, what: str) -> float | None:
        if received_at_s - measured_at_s > self.settings.oldest_s:
            self.refused[f"{what}: measured more than {self.settings.oldest_s:g} s ago"] += 1
            return None
        return measured_at_s
