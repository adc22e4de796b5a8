"""From messages to measurements: frame, time and noise of everything that an estimator takes.

A vehicle's own position becomes a PositionMeasurement only while its GPS is trusted. Of any other vehicle only the barometric
altitude, the attitude and the airspeed are evidence.

What was measured at an uncertain time was measured at an uncertain place: a position gets speed times time sigma as further
noise, a range the relative speed times it. Ranges state that part apart as well, for an estimator that models clocks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import hypot
from typing import NamedTuple

from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.core.messages.inbound import Attitude, GlobalPosition, GpsReceiver, PeerRange, Pressure, TimeBase
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.setting_bounds import check_bounds, positive
from gcs_coloc.core.stations.node_id import node_name
from gcs_coloc.core.stations.stations import BeaconIds, Station
from gcs_coloc.core.telemetry.pressure_height import PressureHeights
from gcs_coloc.core.telemetry.repeated_ranges import RangeRepeats
from gcs_coloc.core.telemetry.reported_state import ReportedState, true_airspeed_mps

_AIRSPEED_FRESH_S = 1.0  # chosen: five periods of VFR_HUD at the requested rate
_RANGE_SIGMA_GAIN = 0.1  # of each range in the mean of late; chosen: it follows within about a second at 10 Hz
_MOST_BIAS_M, _MOST_SCALE = 1000.0, 0.1  # chosen: beyond, it is another unit and no calibration
_EARTH_RADIUS_M = 6_371_000.0  # IUGG's mean radius
_UNKNOWN_SPEED_MPS = 30.0  # chosen: a fast fixed-wing aircraft of a few kilograms
_PLACED_FOR_S = 2.0  # chosen: ten positions at the rate that vehicles send them, of which a radio loses some
_FIX_3D = 3  # GPS_FIX_TYPE_3D_FIX


class _Place(NamedTuple):
    """Where a vehicle was at a time (east, north), within what, and how fast it may have left; service time, m, m/s."""

    east_m: float
    north_m: float
    sigma_m: float
    at_s: float
    speed_mps: float

    def sigma_at(self, now_s: float) -> float:
        """Return within what the vehicle is there now, m."""
        return self.sigma_m + self.speed_mps * max(now_s - self.at_s, 0.0)


class SentFix(NamedTuple):
    """A fix that aiding sent to a vehicle: when (service time, s), and the 1-sigma of its height, m."""

    at_s: float
    sigma_v_m: float


class BuiltPosition(NamedTuple):
    """The position that a vehicle reports, believed or not, and the measurement that it is evidence for, if any."""

    reported: PositionMeasurement
    measurement: PositionMeasurement | AltitudeMeasurement | None


class BuiltRange(NamedTuple):
    """A range, None where it is refused, and what the operator must know of the device that measured it."""

    measurement: RangeMeasurement | None
    notice: Notice | None = None


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
    range_bias_m: Mapping[int, float] = field(default_factory=dict)
    """Lasting error of the ranging device of single vehicles by system id, m, as `4 = 0.25`; from `gcs-coloc calibrate`.
    A range of two vehicles is (1 + both scales) times the distance plus both biases."""
    range_scale: Mapping[int, float] = field(default_factory=dict)
    """Scale error of the ranging device of single vehicles by system id, as `4 = 0.002`: the excess over 1."""
    ranging_beacon_ids: BeaconIds = "stations"
    """Whose id the `beacon_id` of a RANGING_BEACON without a position is: a fixed station's, as MAVLink has it,
    or with `vehicles` the system id of a vehicle. With a position it is always a station's."""
    altitude_sigma_m: float = positive(2.0)
    """Of a barometric height. Chosen: its drift over a flight."""
    max_age_s: float = positive(5.0)
    """An older measurement is refused. Chosen: longer than any link's delay, shorter than a stamp from another clock."""

    def __post_init__(self) -> None:
        check_bounds(self)
        for name, most in (("range_bias_m", _MOST_BIAS_M), ("range_scale", _MOST_SCALE)):
            table: Mapping[int, float] = getattr(self, name)
            for sysid, value in table.items():
                if not 1 <= sysid <= 255:
                    raise ValueError(f"{name}: {sysid} is not a MAVLink system id (1 to 255)")
                if not abs(value) <= most:
                    raise ValueError(f"{name}: {value:g} of vehicle {sysid} is not within {-most:g} to {most:g}")


@dataclass(slots=True)
class _Memory:
    """What the builder keeps of one vehicle.

    `height_sigma_m` is how uncertain its height is beyond its barometer, where that began with a fix of ours. `range_sigma_m` is
    the 1-sigma of its ranges of late, with the errors of its peers' positions in it. `place` is where it was while trusted,
    `near` where a trusted vehicle was that is in range of it.
    """

    reported: PositionMeasurement | None = None
    receiver_fix: PositionMeasurement | None = None
    delay_s: float | None = None
    height_reported_at_s: float | None = None
    height_sigma_m: float = 0.0
    range_sigma_m: float | None = None
    place: _Place | None = None
    near: _Place | None = None
    repeats: RangeRepeats = field(default_factory=RangeRepeats)


class MeasurementBuilder:
    """Turns the messages of one fleet into measurements about its origin. `refused` counts what it refuses.

    `frame` is the fleet's: None until the first position of a vehicle with trusted GPS sets its origin, or a station does.
    """

    def __init__(self, settings: MeasurementSettings, clocks: FleetClocks) -> None:
        self.settings = settings
        self.frame: LocalFrame | None = None
        self.refused: Counter[CoreRefusal] = Counter()
        self._clocks = clocks
        self._memories: dict[int, _Memory] = {}
        self._pressures = PressureHeights()

    def set_origin(self, station: Station) -> None:
        """Set the fleet's origin at a station, where no vehicle has set it yet."""
        if self.frame is None and station.position is not None:
            self.frame = LocalFrame(station.position.lat_deg, station.position.lon_deg, station.position.alt_msl_m)

    def position(
        self,
        message: GlobalPosition,
        vehicle: ReportedState,
        *,
        is_trusted: bool,
        sent_fix: SentFix | None = None,
        located_enu_m: tuple[float, float] | None = None,
    ) -> BuiltPosition | None:
        """Build the position of a trusted vehicle, the altitude of any other; None for a refused stamp or no frame.

        The altitude is the autopilot's, which may hold what we sent, and only where its barometer itself is not heard.
        `sent_fix` is the last fix that the vehicle was sent, `located_enu_m` where the estimator has it (east, north).
        There is no altitude before anything tells where the vehicle is: the earth falls away from the frame's plane.
        """
        measured = self._clocks.stamp(message)
        if measured is None:
            return None
        if self.frame is None and is_trusted:
            self.frame = LocalFrame(message.lat_deg, message.lon_deg, message.alt_msl_m)
        if self.frame is None:
            return None
        memory = self._of(message.sysid)
        reported = memory.reported = self._reported(message, self.frame, vehicle, measured)
        self._update_height_datum(message, memory, measured, sent_fix, is_trusted=is_trusted)
        memory.delay_s = reported.arrived_at_s - reported.measured_at_s
        now_s = message.received_at_s
        if is_trusted:
            self._pressures.learn(message.sysid, message.alt_msl_m, now_s)
            east_m, north_m, _ = reported.position_enu_m
            memory.place = _Place(east_m, north_m, 0.0, now_s, hypot(message.vn_mps, message.ve_mps))
            return BuiltPosition(reported, reported)
        if self._pressures.height(message.sysid, now_s) is not None:
            return BuiltPosition(reported, None)
        sigma_m = hypot(self.settings.altitude_sigma_m, memory.height_sigma_m, message.vd_mps * measured.sigma_s)
        return BuiltPosition(reported, self._altitude(message, message.alt_msl_m, sigma_m, self.frame, measured, located_enu_m))

    def pressure(
        self, message: Pressure, *, is_trusted: bool, located_enu_m: tuple[float, float] | None = None
    ) -> AltitudeMeasurement | None:
        """Build the height by the barometer of a vehicle that is not trusted; None where nothing tells what it means."""
        measured = self._clocks.stamp(message)
        if measured is None:
            return None
        self._pressures.add(message.sysid, message.pressure_hpa, message.received_at_s)
        height = self._pressures.height(message.sysid, message.received_at_s)
        if is_trusted or height is None or self.frame is None:
            return None
        sigma_m = hypot(self.settings.altitude_sigma_m, height.sigma_m)
        return self._altitude(message, height.alt_msl_m, sigma_m, self.frame, measured, located_enu_m)

    def attitude(self, message: Attitude, vehicle: ReportedState) -> AttitudeMeasurement | None:
        """Build an attitude with the newest true airspeed, if that is fresh and the vehicle flies on wings.

        A multirotor flies to any side, and banks to do so without turning: its airspeed says nothing of its course.
        """
        measured = self._clocks.stamp(message)
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

    def range(self, message: PeerRange, vehicle: ReportedState, peer: ReportedState | Station | None) -> BuiltRange:
        """Build a range of a vehicle to another one or a station; `peer` is None where the other end was never heard."""
        if peer is None:
            self.refused[CoreRefusal.RANGE_PEER_UNKNOWN] += 1
            return BuiltRange(None)
        memory = self._of(message.sysid)
        measured = self._clocks.range_time(message, memory.delay_s)
        if measured is None:
            return BuiltRange(None)
        was_stuck = (message.peer, message.device_id) in memory.repeats.stuck
        is_stuck = memory.repeats.add(message.peer, message.device_id, message.range_m, message.measured_at_s)
        notice = _device_notice(message, is_stuck=is_stuck) if is_stuck is not was_stuck else None
        if is_stuck:
            self.refused[CoreRefusal.RANGE_REPEATED] += 1
            return BuiltRange(None, notice)
        sigma_m = message.sigma_m if message.sigma_m is not None else self.settings.range_sigma_m
        # A range locates either end, whichever of the two measured it; a station is where it is.
        self._update_range_sigma(vehicle, hypot(sigma_m, self._position_sigma_m(peer)))
        self._update_near(vehicle, self._place_of(peer, message.received_at_s), message)
        if not isinstance(peer, Station):
            self._update_range_sigma(peer, hypot(sigma_m, self._position_sigma_m(vehicle)))
            self._update_near(peer, self._place_of(vehicle, message.received_at_s), message)
        late_m = _relative_speed_mps(vehicle, peer) * measured.sigma_s
        by_own_clock = message.measured_at_s is not None and message.time_base is not TimeBase.SERVICE
        measurement = RangeMeasurement(
            from_vehicle=message.sysid,
            to_vehicle=message.peer,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            range_m=self._calibrated_m(message, peer),
            sigma_m=hypot(sigma_m, late_m),
            device_id=message.device_id,
            clock_of=message.sysid if by_own_clock else None,
            time_sigma_s=measured.sigma_s,
            time_sigma_m=late_m,
        )
        return BuiltRange(measurement, notice)

    def _update_range_sigma(self, end: ReportedState, total_m: float) -> None:
        memory = self._of(end.sysid)
        before_m = memory.range_sigma_m if memory.range_sigma_m is not None else total_m
        memory.range_sigma_m = before_m + _RANGE_SIGMA_GAIN * (total_m - before_m)

    def _update_near(self, end: ReportedState, place: _Place | None, message: PeerRange) -> None:
        """Keep where the other end of a range is: this end is as far from there as the range."""
        if place is not None:
            at_s = message.received_at_s
            self._of(end.sysid).near = _Place(place.east_m, place.north_m, message.range_m, at_s, _UNKNOWN_SPEED_MPS)

    def _place_of(self, node: ReportedState | Station, now_s: float) -> _Place | None:
        """Return where a trusted vehicle was of late, or where a station is; None where that is not known."""
        if not isinstance(node, Station):
            place = self._of(node.sysid).place
            return place if place is not None and now_s - place.at_s <= _PLACED_FOR_S else None
        where = node.measurement(self.frame, now_s) if self.frame is not None else None
        return _Place(*where.position_enu_m[:2], 0.0, now_s, 0.0) if where is not None else None

    def _position_sigma_m(self, node: ReportedState | Station) -> float:
        """Return the horizontal 1-sigma of where a vehicle says that it is, or where a station is, m."""
        if isinstance(node, Station):
            return node.position.sigma_h_m if node.position is not None else 0.0
        return self._accuracy(node.receiver)[0]

    def _calibrated_m(self, message: PeerRange, peer: ReportedState | Station) -> float:
        """Return the range without the lasting errors of both devices, as `gcs-coloc calibrate` finds them."""
        biases, scales = self.settings.range_bias_m, self.settings.range_scale
        of_station = (peer.range_bias_m, peer.range_scale) if isinstance(peer, Station) else (0.0, 0.0)
        if not biases and not scales and not any(of_station):
            return message.range_m
        ends = (message.sysid, message.peer)
        bias_m = sum(biases.get(end, 0.0) for end in ends) + of_station[0]
        scale = sum(scales.get(end, 0.0) for end in ends) + of_station[1]
        return max((message.range_m - bias_m) / (1.0 + scale), 0.0)

    def add_receiver(self, message: GpsReceiver, vehicle: ReportedState, *, is_trusted: bool) -> None:
        """Add a report of a vehicle's own receiver: while it is not trusted, `receiver_fix` has it as a measurement."""
        self._of(message.sysid).receiver_fix = None if is_trusted else self._receiver_fix(message, vehicle)

    def reported(self, sysid: int) -> PositionMeasurement | None:
        """Return the newest position that a vehicle reported of itself, believed or not."""
        return self._of(sysid).reported

    def receiver_fix(self, sysid: int) -> PositionMeasurement | None:
        """Return the newest fix of a vehicle's own receiver while that is not trusted; None without a 3D fix or a frame."""
        return self._of(sysid).receiver_fix

    def delay_s(self, sysid: int) -> float | None:
        """Return how long the newest position was under way beyond what is assumed, s."""
        return self._of(sysid).delay_s

    def range_sigma_m(self, sysid: int) -> float | None:
        """Return the 1-sigma of a vehicle's ranges of late, with the errors of its peers' positions in it, m."""
        return self._of(sysid).range_sigma_m

    def _of(self, sysid: int) -> _Memory:
        memory = self._memories.get(sysid)
        if memory is None:
            memory = self._memories[sysid] = _Memory()
        return memory

    def _reported(
        self, message: GlobalPosition, frame: LocalFrame, vehicle: ReportedState, measured: ServiceTime
    ) -> PositionMeasurement:
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

    def _receiver_fix(self, message: GpsReceiver, vehicle: ReportedState) -> PositionMeasurement | None:
        # The velocity is the autopilot's. What the unknown age of the fix means at that speed is in `sigma_h_m`.
        if self.frame is None or message.fix_type < _FIX_3D:
            return None
        measured = self._clocks.fix_time(message)
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

    def _altitude(
        self,
        message: GlobalPosition | Pressure,
        alt_msl_m: float,
        sigma_m: float,
        frame: LocalFrame,
        measured: ServiceTime,
        located_enu_m: tuple[float, float] | None,
    ) -> AltitudeMeasurement | None:
        """Build the up coordinate of an altitude. At a distance D from the origin a place off by d changes it by D d / R."""
        now_s, memory = message.received_at_s, self._of(message.sysid)
        places = [_Place(*located_enu_m, 0.0, now_s, 0.0)] if located_enu_m is not None else [memory.place, memory.near]
        place = min((p for p in places if p is not None), key=lambda p: p.sigma_at(now_s), default=None)
        if place is None:
            return None
        up_m = frame.up_from_height(place.east_m, place.north_m, alt_msl_m)
        fallen_m = hypot(place.east_m, place.north_m) * place.sigma_at(now_s) / _EARTH_RADIUS_M
        return AltitudeMeasurement(message.sysid, measured.at_s, now_s, up_m, hypot(sigma_m, fallen_m))

    def _update_height_datum(
        self, message: GlobalPosition, memory: _Memory, measured: ServiceTime, sent: SentFix | None, *, is_trusted: bool
    ) -> None:
        """Update how well an autopilot's height is known where it begins.

        The first fix since it booted gives its barometer the datum. Where that was a fix of ours, its height is ours come back,
        and no better known than that was.
        """
        booted_at_s = self._clocks.booted_at_s(message, measured)
        if is_trusted:
            memory.height_sigma_m = 0.0
        elif memory.height_reported_at_s is None or booted_at_s > memory.height_reported_at_s:
            memory.height_sigma_m = sent.sigma_v_m if sent is not None and sent.at_s > booted_at_s else 0.0
        memory.height_reported_at_s = message.received_at_s

    def _alt_msl_m(self, vehicle: ReportedState) -> float:
        """Return the altitude of a vehicle; that of the fleet's origin, or sea level, where it reports none."""
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


def _device_notice(message: PeerRange, *, is_stuck: bool) -> Notice:
    device, at_s = f"its ranging device {message.device_id}", message.received_at_s
    if is_stuck:
        text = f"{device} repeats one value, {message.range_m:.2f} m to {node_name(message.peer)}: it is stuck and not used"
        return Notice(at_s, message.sysid, "warning", text)
    return Notice(at_s, message.sysid, "info", f"{device} measures {node_name(message.peer)} again")


def _relative_speed_mps(vehicle: ReportedState, peer: ReportedState | Station) -> float:
    """The most by which a range changes per second; one vehicle's own speed where only that is known, or the other end stands."""
    vn, ve, vd = (
        (vehicle.position.vn_mps, vehicle.position.ve_mps, vehicle.position.vd_mps) if vehicle.position else (0.0, 0.0, 0.0)
    )
    if isinstance(peer, ReportedState) and peer.position is not None:
        vn, ve, vd = vn - peer.position.vn_mps, ve - peer.position.ve_mps, vd - peer.position.vd_mps
    return hypot(vn, ve, vd)
