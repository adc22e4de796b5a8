"""From messages to measurements: frame, time and noise of everything that an estimator is fed with.

The rule that matters most stands here: a vehicle's own position becomes a PositionMeasurement only while its GPS is
HEALTHY. Of any other vehicle only the barometric altitude, the attitude and the airspeed are evidence.

What was measured at an uncertain time was measured at an uncertain place: positions are given speed times time sigma as
further noise, ranges the relative speed times it. That part is told as well, so that an estimator which knows of clocks can
take it out again.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import hypot

from gcs_coloc.core.clocks.sender_clock import SenderClock
from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime, TimeSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.core.messages.inbound import Attitude, GlobalPosition, GpsReceiver, PeerRange, SystemTime, TimeBase
from gcs_coloc.core.setting_bounds import check_bounds, positive
from gcs_coloc.core.telemetry.air_data import true_airspeed_mps
from gcs_coloc.core.telemetry.vehicles import Vehicle

_AIRSPEED_FRESH_S = 1.0
_RANGE_CLOCKS_PER_VEHICLE = 16
_RANGE_ERROR_GAIN = 0.1
_OTHER_WAY_SHARE = 0.5
_FIX_AGE_S, _FIX_AGE_SIGMA_S = 0.1, 0.1  # when an autopilot stamps it; 0.11 s on ArduPlane
_FIX_UNDER_WAY_S, _FIX_UNDER_WAY_SIGMA_S = 0.25, 0.25  # age and link together, where there is no stamp
_LONGEST_FIX_AGE_S = 2.0


@dataclass(frozen=True, slots=True)
class MeasurementSettings:
    """Noise that the wire does not tell (1-sigma per axis), and how old a message may be."""

    position_sigma_h_m: float = positive(5.0)
    """Horizontal, of a receiver that states no accuracy; times its HDOP where that is more than 1.
    Chosen: the user range error of a code receiver without corrections."""
    position_sigma_v_m: float = positive(8.0)
    """Vertical, of a receiver that states no accuracy; times its HDOP where that is more than 1.
    Chosen: 1.6 times the horizontal one, as VDOP to HDOP."""
    velocity_sigma_mps: float = positive(0.5)
    """Of a receiver that states no speed accuracy. Chosen: a Doppler velocity in motion."""
    min_position_sigma_m: float = positive(0.3)
    """No receiver counts as better than this. Chosen: without RTK a smaller stated accuracy is optimistic."""
    range_sigma_m: float = positive(5.0)
    """Of a range that comes without one. Chosen: coarse enough for any ranging radio."""
    altitude_sigma_m: float = positive(2.0)
    """Of a barometric height. Chosen: its drift over a flight."""
    max_age_s: float = positive(5.0)
    """An older measurement is refused. Chosen: longer than any link's delay, shorter than a stamp from another clock."""

    def __post_init__(self) -> None:
        check_bounds(self)


class MeasurementBuilder:
    """Turns the messages of one fleet into measurements about its origin. Refusals are counted by reason in `refused`.

    `host_utc_minus_service_s` is the host's UTC where that is known to be right.
    """

    def __init__(self, settings: MeasurementSettings, time_settings: TimeSettings | None = None) -> None:
        self.settings = settings
        self.time_settings = time_settings if time_settings is not None else TimeSettings()
        self.frame: LocalFrame | None = None
        self.host_utc_minus_service_s: float | None = None
        self.refused: Counter[str] = Counter()

    def position(self, message: GlobalPosition, vehicle: Vehicle) -> Measurement | None:
        """The position of a healthy vehicle, the barometric altitude of any other; sets the origin with the first fix.

        Either way the record of the vehicle keeps what it claims.
        """
        measured = self._boot_time(message, vehicle, "GLOBAL_POSITION_INT")
        if measured is None:
            return None
        healthy = vehicle.health.trusted
        if self.frame is None and healthy:
            self.frame = LocalFrame(message.lat_deg, message.lon_deg, message.alt_msl_m)
        if self.frame is None:
            return None
        vehicle.claim = self._claim(message, self.frame, vehicle, measured)
        _note_datum(message, vehicle, measured)
        return vehicle.claim if healthy else self._altitude(message, vehicle, measured)

    def _claim(self, message: GlobalPosition, frame: LocalFrame, vehicle: Vehicle, measured: ServiceTime) -> PositionMeasurement:
        ned = (message.vn_mps, message.ve_mps, message.vd_mps)
        sigma_h_m, sigma_v_m, sigma_velocity_mps = self._accuracy(vehicle.receiver)
        return PositionMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            position_enu_m=frame.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m),
            sigma_h_m=hypot(sigma_h_m, hypot(message.vn_mps, message.ve_mps) * measured.sigma_s),
            sigma_v_m=hypot(sigma_v_m, message.vd_mps * measured.sigma_s),
            velocity_enu_mps=frame.enu_from_ned_velocity(message.lat_deg, message.lon_deg, ned),
            sigma_velocity_mps=sigma_velocity_mps,
            time_sigma_s=measured.sigma_s,
        )

    def receiver_fix(self, message: GpsReceiver, vehicle: Vehicle) -> PositionMeasurement | None:
        """Where a vehicle's own receiver says that it is, whether it is to be believed or not; None without a 3D fix or a frame.

        The velocity is the autopilot's. What the unknown age of the fix means at that speed is in `sigma_h_m`.
        """
        if self.frame is None or message.fix_type < 3:
            return None
        measured = self._fix_time(message, vehicle)
        at = vehicle.position
        ned = (at.vn_mps, at.ve_mps, at.vd_mps) if at is not None else (0.0, 0.0, 0.0)
        sigma_h_m, sigma_v_m, sigma_velocity_mps = self._accuracy(message)
        return PositionMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            position_enu_m=self.frame.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m),
            sigma_h_m=hypot(sigma_h_m, hypot(ned[0], ned[1]) * measured.sigma_s),
            sigma_v_m=hypot(sigma_v_m, ned[2] * measured.sigma_s),
            velocity_enu_mps=self.frame.enu_from_ned_velocity(message.lat_deg, message.lon_deg, ned),
            sigma_velocity_mps=sigma_velocity_mps,
            time_sigma_s=measured.sigma_s,
        )

    def attitude(self, message: Attitude, vehicle: Vehicle) -> AttitudeMeasurement | None:
        """Attitude with the true airspeed by what was heard last, if that is fresh and the vehicle flies on wings.

        A multirotor flies to any side, and banks to do so without turning: what it tells of the air says nothing of its course.
        """
        measured = self._boot_time(message, vehicle, "ATTITUDE")
        if measured is None:
            return None
        air = vehicle.airspeed
        fresh = vehicle.winged and air is not None and message.received_at_s - air.received_at_s <= _AIRSPEED_FRESH_S
        return AttitudeMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            roll_rad=message.roll_rad,
            pitch_rad=message.pitch_rad,
            yaw_rad=message.yaw_rad,
            airspeed_mps=true_airspeed_mps(air.airspeed_mps, self._alt_msl_m(vehicle)) if air is not None and fresh else None,
        )

    def range(self, message: PeerRange, vehicle: Vehicle, peer: Vehicle | None) -> RangeMeasurement | None:
        """A range between two vehicles of the fleet; `peer` is None where the other end was never heard."""
        if peer is None:
            self.refused["range: peer is not a vehicle that was heard"] += 1
            return None
        measured = self._range_time(message, vehicle)
        if measured is None:
            return None
        if vehicle.range_repeats.take(message.peer_sysid, message.device_id, message.range_m, message.measured_at_s):
            self.refused["range: its device repeats one value"] += 1
            return None
        sigma_m = message.sigma_m if message.sigma_m is not None else self.settings.range_sigma_m
        error_m = hypot(sigma_m, self._accuracy(peer.receiver)[0])
        before_m = vehicle.range_error_m if vehicle.range_error_m is not None else error_m
        vehicle.range_error_m = before_m + _RANGE_ERROR_GAIN * (error_m - before_m)
        late_m = _relative_speed_mps(vehicle, peer) * measured.sigma_s
        by_own_clock = message.measured_at_s is not None and message.time_base is not TimeBase.SERVICE
        return RangeMeasurement(
            from_vehicle=message.sysid,
            to_vehicle=message.peer_sysid,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            range_m=message.range_m,
            sigma_m=hypot(sigma_m, late_m),
            device_id=message.device_id,
            clock_of=message.sysid if by_own_clock else None,
            time_sigma_s=measured.sigma_s,
            time_sigma_m=late_m,
        )

    def utc_minus_service_s(self, message: SystemTime, vehicle: Vehicle) -> float | None:
        """UTC minus service clock as a vehicle knows it; None where it does not know UTC or its clock jumped."""
        measured = self._boot_time(message, vehicle, "SYSTEM_TIME")
        if message.unix_s is None or measured is None:
            return None
        if self.host_utc_minus_service_s is not None and vehicle.health.trusted:
            vehicle.clock.take_utc(message.unix_s, message.boot_s, self.host_utc_minus_service_s)
        return message.unix_s - measured.at_s

    def up_m(self, alt_msl_m: float, near_enu_m: tuple[float, float]) -> float:
        """The up coordinate of an altitude over a place (east, north) in the frame. Only where there is a frame."""
        assert self.frame is not None
        return self.frame.up_from_height(near_enu_m[0], near_enu_m[1], alt_msl_m)

    def _altitude(self, message: GlobalPosition, vehicle: Vehicle, measured: ServiceTime) -> AltitudeMeasurement | None:
        if self.frame is None:
            return None
        where = vehicle.last_known_enu_m
        return AltitudeMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            up_m=self.up_m(message.alt_msl_m, where if where is not None else (0.0, 0.0)),
            sigma_m=hypot(self.settings.altitude_sigma_m, vehicle.height_datum_sigma_m, message.vd_mps * measured.sigma_s),
        )

    def _alt_msl_m(self, vehicle: Vehicle) -> float:
        """The altitude of a vehicle; that of the fleet's origin, or sea level, where it tells none."""
        if vehicle.position is not None:
            return vehicle.position.alt_msl_m
        return self.frame.height_m if self.frame is not None else 0.0

    def _accuracy(self, receiver: GpsReceiver | None) -> tuple[float, float, float]:
        s = self.settings
        stated_h = receiver.h_acc_m if receiver is not None else None
        stated_v = receiver.v_acc_m if receiver is not None else None
        stated_speed = receiver.speed_acc_mps if receiver is not None else None
        # The error is that of one satellite's range times the dilution; the vertical one follows the horizontal one.
        dilution = max(receiver.hdop, 1.0) if receiver is not None and receiver.hdop is not None else 1.0
        sigma_h_m = max(stated_h, s.min_position_sigma_m) if stated_h is not None else s.position_sigma_h_m * dilution
        sigma_v_m = max(stated_v, s.min_position_sigma_m) if stated_v is not None else s.position_sigma_v_m * dilution
        return sigma_h_m, sigma_v_m, stated_speed if stated_speed is not None else s.velocity_sigma_mps

    def _boot_time(self, message: GlobalPosition | Attitude | SystemTime, vehicle: Vehicle, what: str) -> ServiceTime | None:
        if not vehicle.clock.learn(message.boot_s, message.received_at_s):
            self.refused[f"{what}: its clock jumped"] += 1
            return None
        measured = vehicle.clock.to_service(message.boot_s, message.received_at_s, self.time_settings)
        return self._fresh(measured, message.received_at_s, what)

    def _fix_time(self, message: GpsReceiver, vehicle: Vehicle) -> ServiceTime:
        now_s = message.received_at_s
        if message.fixed_boot_s is not None and vehicle.clock.stamps.known:
            stamped = vehicle.clock.to_service(message.fixed_boot_s, now_s, self.time_settings)
            # Some autopilots and simulators put another clock's time there.
            if 0.0 <= now_s + 3.0 * stamped.sigma_s - stamped.at_s <= _LONGEST_FIX_AGE_S:
                return ServiceTime(stamped.at_s - _FIX_AGE_S, hypot(stamped.sigma_s, _FIX_AGE_SIGMA_S))
        return ServiceTime(now_s - _FIX_UNDER_WAY_S, _FIX_UNDER_WAY_SIGMA_S)

    def _range_time(self, message: PeerRange, vehicle: Vehicle) -> ServiceTime | None:
        if message.measured_at_s is None:
            # As long on the way as the vehicle's newest position, or by another way: from not at all to twice as long.
            delay_s = max(vehicle.delay_s or 0.0, 0.0)
            sigma_s = hypot(self.time_settings.min_delay_sigma_s, _OTHER_WAY_SHARE * delay_s)
            return self._fresh(ServiceTime(message.received_at_s - delay_s, sigma_s), message.received_at_s, "range")
        if message.time_base is TimeBase.SERVICE:
            return self._fresh(ServiceTime(message.measured_at_s, 0.0), message.received_at_s, "range")
        # A ranging device or companion computer may have booted apart from the autopilot.
        key = (message.time_base, message.device_id)
        clock = vehicle.range_clocks.get(key)
        if clock is None:
            if len(vehicle.range_clocks) >= _RANGE_CLOCKS_PER_VEHICLE:
                self.refused["range: more clocks than a vehicle may have"] += 1
                return None
            clock = vehicle.range_clocks[key] = SenderClock()
        if not clock.learn(message.measured_at_s, message.received_at_s):
            self.refused["range: its clock jumped"] += 1
            return None
        measured = vehicle.clock.device_to_service(clock, message.measured_at_s, message.received_at_s, self.time_settings)
        return self._fresh(measured, message.received_at_s, "range")

    def _fresh(self, measured: ServiceTime, received_at_s: float, what: str) -> ServiceTime | None:
        if received_at_s - measured.at_s > self.settings.max_age_s:
            self.refused[f"{what}: measured more than {self.settings.max_age_s:g} s ago"] += 1
            return None
        return measured


def _note_datum(message: GlobalPosition, vehicle: Vehicle, measured: ServiceTime) -> None:
    """Note how well an autopilot's height is known where it begins.

    The first fix since it booted gives its barometer the datum. Where that was a fix of ours, its height is ours come back, and
    no better known than that was.
    """
    booted_at_s, sent = measured.at_s - vehicle.clock.stamps.unwrapped(message.boot_s), vehicle.fix_sent
    if vehicle.health.trusted:
        vehicle.height_datum_sigma_m = 0.0
    elif vehicle.height_told_at_s is None or booted_at_s > vehicle.height_told_at_s:
        vehicle.height_datum_sigma_m = sent.sigma_v_m if sent is not None and sent.at_s > booted_at_s else 0.0
    vehicle.height_told_at_s = message.received_at_s


def _relative_speed_mps(vehicle: Vehicle, peer: Vehicle) -> float:
    """The most by which the range between two vehicles changes per second; one vehicle's own speed where only that is known."""
    vn, ve, vd = (
        (vehicle.position.vn_mps, vehicle.position.ve_mps, vehicle.position.vd_mps) if vehicle.position else (0.0, 0.0, 0.0)
    )
    if peer.position is not None:
        vn, ve, vd = vn - peer.position.vn_mps, ve - peer.position.ve_mps, vd - peer.position.vd_mps
    return hypot(vn, ve, vd)
