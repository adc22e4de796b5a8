"""The builder of altitude measurements of vehicles whose position is not trusted.

An altitude comes from the barometer, or is the autopilot's own height. It is above the curved earth, while the frame is a plane.
Where a vehicle roughly is tells by how much they differ there.

The height that an autopilot reports is its filter's: while the vehicle is aided it may hold what we sent. The pressure altitude
of SCALED_PRESSURE is the sensor's own. It differs from the height above mean sea level by the weather and by the sensor: that
offset is learnt while the vehicle's GPS is trusted. What the weather does to it afterwards is seen in the offsets of the
vehicles that are still trusted.

Source of the pressure altitude: International Standard Atmosphere (ISO 2533), the layer up to 11 km.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from math import exp, hypot
from statistics import fmean
from typing import NamedTuple

from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement
from gcs_coloc.core.messages.inbound import GlobalPosition, PeerRange, Pressure
from gcs_coloc.core.stations.stations import Station
from gcs_coloc.core.telemetry.reported_state import ReportedState

_EARTH_RADIUS_M = 6_371_000.0  # IUGG's mean radius
_UNKNOWN_SPEED_MPS = 30.0  # chosen: a fast fixed-wing aircraft of a few kilograms
_PLACED_FOR_S = 2.0  # chosen: ten positions at the rate that vehicles send them, of which a radio loses some
_SEA_LEVEL_HPA = 1013.25  # Source: U.S. Standard Atmosphere 1976
_SCALE_M = 44_330.77  # Source: the same: 288.15 K at sea level over a lapse of 0.0065 K/m
_EXPONENT = 0.190263  # Source: the same: lapse times gas constant of air over gravity
_LEARNS_IN_S = 10.0  # chosen: long against a barometer's noise, short against a change of the weather
_LEAST_LEARNT_S = 5.0  # chosen: half of the noise is gone
_FRESH_S = 2.0  # chosen: two messages at the rate that autopilots send by default
_OTHER_SENSOR_SIGMA_M = 8.0  # chosen: barometers of one kind differ by up to 1 hPa
_SCALE_SIGMA = 0.03  # of the climb since the offset was learnt: a day 10 K off the standard


def pressure_altitude_m(pressure_hpa: float) -> float:
    """Altitude (m) of a pressure (hPa) in the standard atmosphere."""
    ratio: float = (pressure_hpa / _SEA_LEVEL_HPA) ** _EXPONENT
    return _SCALE_M * (1.0 - ratio)


class PressureHeight(NamedTuple):
    """A height above mean sea level by a barometer, m, with its 1-sigma beyond the sensor's noise."""

    alt_msl_m: float
    sigma_m: float


@dataclass(slots=True)
class _Barometer:
    """What is known of one vehicle's barometer.

    `offset_m`: height minus pressure altitude, learnt for `learnt_s`. `others_m`: the offsets of the others at that time.
    """

    altitude_m: float = 0.0
    at_s: float = float("-inf")
    offset_m: float | None = None
    offset_at_s: float = 0.0
    learnt_s: float = 0.0
    learnt_altitude_m: float = 0.0
    others_m: dict[int, float] = field(default_factory=dict)


class PressureHeights:
    """The barometers of one fleet."""

    def __init__(self) -> None:
        self._barometers: dict[int, _Barometer] = {}

    def forget(self, sysid: int) -> None:
        """Forget a barometer: another one under its id shows no change of the weather against it."""
        self._barometers.pop(sysid, None)
        for barometer in self._barometers.values():
            barometer.others_m.pop(sysid, None)

    def add(self, sysid: int, pressure_hpa: float, at_s: float) -> None:
        """Add the pressure that a vehicle measured."""
        barometer = self._barometers.setdefault(sysid, _Barometer())
        barometer.altitude_m, barometer.at_s = pressure_altitude_m(pressure_hpa), at_s

    def learn(self, sysid: int, alt_msl_m: float, at_s: float) -> None:
        """Learn the offset of a barometer from the height of its vehicle, whose GPS is trusted."""
        barometer = self._barometers.get(sysid)
        if barometer is None or at_s - barometer.at_s > _FRESH_S:
            return
        offset_m, since_s = alt_msl_m - barometer.altitude_m, at_s - barometer.offset_at_s
        if barometer.offset_m is None or since_s > 6.0 * _LEARNS_IN_S:
            barometer.offset_m, barometer.learnt_s = offset_m, 0.0
        else:
            barometer.offset_m += (1.0 - exp(-since_s / _LEARNS_IN_S)) * (offset_m - barometer.offset_m)
            barometer.learnt_s += since_s
        barometer.offset_at_s, barometer.learnt_altitude_m = at_s, barometer.altitude_m
        barometer.others_m = self._offsets_of_others(sysid, at_s)

    def height(self, sysid: int, at_s: float) -> PressureHeight | None:
        """Return the height of a vehicle by its barometer; None where it is not known.

        It is not known while the barometer is silent, or nothing tells its offset.
        """
        barometer = self._barometers.get(sysid)
        if barometer is None or at_s - barometer.at_s > _FRESH_S:
            return None
        others_m = self._offsets_of_others(sysid, at_s)
        if barometer.offset_m is not None and barometer.learnt_s >= _LEAST_LEARNT_S:
            changes_m = [
                offset_m - barometer.others_m[other] for other, offset_m in others_m.items() if other in barometer.others_m
            ]
            alt_msl_m = barometer.altitude_m + barometer.offset_m + (fmean(changes_m) if changes_m else 0.0)
            return PressureHeight(alt_msl_m, _SCALE_SIGMA * abs(barometer.altitude_m - barometer.learnt_altitude_m))
        if not others_m:
            return None
        climb_m = barometer.altitude_m - fmean(self._barometers[other].altitude_m for other in others_m)
        sigma_m = hypot(_OTHER_SENSOR_SIGMA_M, _SCALE_SIGMA * climb_m)
        return PressureHeight(barometer.altitude_m + fmean(others_m.values()), sigma_m)

    def _offsets_of_others(self, sysid: int, at_s: float) -> dict[int, float]:
        return {
            other: barometer.offset_m
            for other, barometer in self._barometers.items()
            if other != sysid
            and barometer.offset_m is not None
            and barometer.learnt_s >= _LEAST_LEARNT_S
            and at_s - barometer.offset_at_s <= _FRESH_S
        }


class _Place(NamedTuple):
    """Where a vehicle was at a time, and how far it may be from there.

    `east_m` and `north_m` are in the fleet's frame, and right within `sigma_m`. `at_s` is service time. `speed_mps` is how fast
    it may have left.
    """

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


@dataclass(slots=True)
class _Memory:
    """What the builder keeps of one vehicle.

    `datum_sigma_m` is how uncertain its height is beyond its barometer, where that began with a fix of ours. `place` is where it
    was while trusted, `near` where a trusted vehicle was that is in range of it.
    """

    height_reported_at_s: float | None = None
    datum_sigma_m: float = 0.0
    place: _Place | None = None
    near: _Place | None = None


class AltitudeBuilder:
    """Builds the altitudes of one fleet's vehicles.

    There is none before anything tells where the vehicle is: the earth falls away from the frame's plane.
    """

    def __init__(self) -> None:
        self._memories: defaultdict[int, _Memory] = defaultdict(_Memory)
        self._pressures = PressureHeights()

    def forget(self, sysid: int) -> None:
        """Forget a vehicle and its barometer."""
        self._memories.pop(sysid, None)
        self._pressures.forget(sysid)

    def add_trusted_position(self, message: GlobalPosition, reported: PositionMeasurement) -> None:
        """Add the position of a trusted vehicle.

        It calibrates the vehicle's barometer, and tells roughly where its peers are.
        """
        memory, now_s = self._memories[message.sysid], message.received_at_s
        memory.datum_sigma_m, memory.height_reported_at_s = 0.0, now_s
        self._pressures.learn(message.sysid, message.alt_msl_m, now_s)
        east_m, north_m, _ = reported.position_enu_m
        memory.place = _Place(east_m, north_m, 0.0, now_s, hypot(message.vn_mps, message.ve_mps))

    def add_range(
        self, message: PeerRange, vehicle: ReportedState, peer: ReportedState | Station, frame: LocalFrame | None
    ) -> None:
        """Add a range: either end is as far from the other as the range, whichever of the two measured it."""
        now_s = message.received_at_s
        of_peer = self._place_of(peer, now_s, frame)
        if not isinstance(peer, Station):
            self._add_near(peer, self._place_of(vehicle, now_s, frame), message)
        self._add_near(vehicle, of_peer, message)

    def from_position(
        self,
        message: GlobalPosition,
        measured: ServiceTime,
        frame: LocalFrame,
        *,
        booted_at_s: float,
        altitude_sigma_m: float,
        sent_fix: SentFix | None,
        located_enu_m: tuple[float, float] | None,
    ) -> AltitudeMeasurement | None:
        """Build the altitude that the autopilot reports, which may hold what we sent.

        None where the barometer itself is heard, or where nothing tells where the vehicle is.

        The first fix since it booted gives its barometer the datum. Where that was a fix of ours (`sent_fix` is the last one),
        its height is ours come back, and no better known than that was. `located_enu_m` is where the estimator has it (east,
        north).
        """
        memory, now_s = self._memories[message.sysid], message.received_at_s
        if memory.height_reported_at_s is None or booted_at_s > memory.height_reported_at_s:
            memory.datum_sigma_m = sent_fix.sigma_v_m if sent_fix is not None and sent_fix.at_s > booted_at_s else 0.0
        memory.height_reported_at_s = now_s
        if self._pressures.height(message.sysid, now_s) is not None:
            return None
        sigma_m = hypot(altitude_sigma_m, memory.datum_sigma_m, message.vd_mps * measured.sigma_s)
        return self._altitude(message, message.alt_msl_m, sigma_m, frame, measured, located_enu_m)

    def sigma_m(self, sysid: int, now_s: float, *, altitude_sigma_m: float) -> float:
        """Return the 1-sigma that the altitude of a trusted vehicle would have without its GPS, m."""
        height = self._pressures.height(sysid, now_s)
        return hypot(altitude_sigma_m, height.sigma_m) if height is not None else altitude_sigma_m

    def add_pressure(self, message: Pressure) -> None:
        """Add what a vehicle's barometer measures."""
        self._pressures.add(message.sysid, message.pressure_hpa, message.received_at_s)

    def from_pressure(
        self,
        message: Pressure,
        measured: ServiceTime,
        frame: LocalFrame,
        *,
        altitude_sigma_m: float,
        located_enu_m: tuple[float, float] | None,
    ) -> AltitudeMeasurement | None:
        """Build the altitude by a barometer whose pressure has been added.

        None where nothing tells what the pressure means, or where the vehicle is.
        """
        height = self._pressures.height(message.sysid, message.received_at_s)
        if height is None:
            return None
        sigma_m = hypot(altitude_sigma_m, height.sigma_m)
        return self._altitude(message, height.alt_msl_m, sigma_m, frame, measured, located_enu_m)

    def _altitude(
        self,
        message: GlobalPosition | Pressure,
        alt_msl_m: float,
        sigma_m: float,
        frame: LocalFrame,
        measured: ServiceTime,
        located_enu_m: tuple[float, float] | None,
    ) -> AltitudeMeasurement | None:
        """Build the measurement of the up coordinate of an altitude; None where no place is known.

        Its noise has that of the place in it. At a distance D from the origin, a place that is off by d changes the up
        coordinate by D d / R, where R is the radius of the earth.
        """
        now_s, memory = message.received_at_s, self._memories[message.sysid]
        places = [_Place(*located_enu_m, 0.0, now_s, 0.0)] if located_enu_m is not None else [memory.place, memory.near]
        place = min((p for p in places if p is not None), key=lambda p: p.sigma_at(now_s), default=None)
        if place is None:
            return None
        up_m = frame.up_from_height(place.east_m, place.north_m, alt_msl_m)
        fallen_m = hypot(place.east_m, place.north_m) * place.sigma_at(now_s) / _EARTH_RADIUS_M
        return AltitudeMeasurement(message.sysid, measured.at_s, now_s, up_m, hypot(sigma_m, fallen_m))

    def _add_near(self, end: ReportedState, place: _Place | None, message: PeerRange) -> None:
        """Keep where the other end of a range is."""
        if place is not None:
            at_s = message.received_at_s
            self._memories[end.sysid].near = _Place(place.east_m, place.north_m, message.range_m, at_s, _UNKNOWN_SPEED_MPS)

    def _place_of(self, node: ReportedState | Station, now_s: float, frame: LocalFrame | None) -> _Place | None:
        """Return where a trusted vehicle was of late, or where a station is; None where that is not known."""
        if not isinstance(node, Station):
            place = self._memories[node.sysid].place
            return place if place is not None and now_s - place.at_s <= _PLACED_FOR_S else None
        where = node.measurement(frame, now_s) if frame is not None else None
        return _Place(*where.position_enu_m[:2], 0.0, now_s, 0.0) if where is not None else None
