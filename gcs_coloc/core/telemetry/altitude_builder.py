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

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import exp, hypot, sqrt
from statistics import fmean
from typing import NamedTuple

from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement
from gcs_coloc.core.messages.inbound import GlobalPosition, PeerRange, Pressure

_EARTH_RADIUS_M = 6_371_000.0  # IUGG's mean radius
_UNKNOWN_SPEED_MPS = 30.0  # chosen: a fast fixed-wing aircraft of a few kilograms
_PLACED_FOR_S = 2.0  # chosen: ten positions at the rate that vehicles send them, of which a radio loses some
_SEA_LEVEL_HPA = 1013.25  # Source: U.S. Standard Atmosphere 1976
_SCALE_M = 44_330.77  # Source: the same: 288.15 K at sea level over a lapse of 0.0065 K/m
_EXPONENT = 0.190263  # Source: the same: lapse times gas constant of air over gravity
_LEARNS_IN_S = 10.0  # chosen: long against a barometer's noise, short against a change of the weather
_LEAST_LEARNT_S = 5.0  # chosen: half of the noise is gone
_LEAST_JUMP_M = 15.0
"""From so far off on a height contradicts its barometer. Chosen: on a day 20 K off the standard a climb at 10 m/s takes the
offset 7 m off its mean."""
_FRESH_S = 2.0  # chosen: two messages at the rate that autopilots send by default
_OTHER_SENSOR_SIGMA_M = 8.0  # chosen: barometers of one kind differ by up to 1 hPa
_SCALE_SIGMA = 0.05
"""Of a climb, all vehicles alike. Chosen: a day 15 K off the standard. An autopilot that takes a warm sensor for the air states
climbs 7 % too high (ArduPilot: at most 35 degrees Celsius)."""
_WEATHER_SIGMA_M = 3.0
"""Chosen: the pressure changes by 0.4 hPa in a flight. Beside others at one height that of a front is followed, too."""
_OTHER_OFFSET_SIGMA_M = 0.5  # chosen: what barometer and filter of one vehicle wander in a flight


def pressure_altitude_m(pressure_hpa: float) -> float:
    """Altitude (m) of a pressure (hPa) in the standard atmosphere."""
    ratio: float = (pressure_hpa / _SEA_LEVEL_HPA) ** _EXPONENT
    return _SCALE_M * (1.0 - ratio)


class PressureHeight(NamedTuple):
    """A height above mean sea level by a barometer, m, with its 1-sigma beyond the sensor's noise."""

    alt_msl_m: float
    sigma_m: float


@dataclass(slots=True, eq=False)
class Barometer:
    """What is known of one vehicle's barometer.

    `offset_m`: height minus pressure altitude, learnt for `learnt_s` at the pressure altitude `learnt_altitude_m`: both are means
    of the same time. `others_m`: those of the others then. A fleet is all barometers, this one among them.
    """

    altitude_m: float = 0.0
    at_s: float = float("-inf")
    offset_m: float | None = None
    offset_at_s: float = 0.0
    learnt_s: float = 0.0
    learnt_altitude_m: float = 0.0
    others_m: Mapping[Barometer, tuple[float, float]] = field(default_factory=dict)

    def add(self, pressure_hpa: float, at_s: float) -> None:
        """Add a pressure."""
        self.altitude_m, self.at_s = pressure_altitude_m(pressure_hpa), at_s

    def learn(self, alt_msl_m: float, at_s: float, fleet: Iterable[Barometer]) -> None:
        """Learn the offset from the height of its vehicle, whose GPS is trusted.

        A height that jumps tells nothing of the barometer; one that stays where it jumped to is learnt anew.
        """
        if at_s - self.at_s > _FRESH_S:
            return
        offset_m, since_s = alt_msl_m - self.altitude_m, at_s - self.offset_at_s
        if self.offset_m is None or since_s > 6.0 * _LEARNS_IN_S:
            self.offset_m, self.learnt_altitude_m, self.learnt_s = offset_m, self.altitude_m, 0.0
        elif self.learnt_s >= _LEAST_LEARNT_S and abs(offset_m - self.offset_m) > _LEAST_JUMP_M:
            return
        else:
            fresh = 1.0 - exp(-since_s / _LEARNS_IN_S)
            self.offset_m += fresh * (offset_m - self.offset_m)
            self.learnt_altitude_m += fresh * (self.altitude_m - self.learnt_altitude_m)
            self.learnt_s += since_s
        self.offset_at_s = at_s
        self.others_m = self._offsets_of_others(at_s, fleet)

    def height(self, at_s: float, fleet: Iterable[Barometer]) -> PressureHeight | None:
        """Return the height of its vehicle; None while it is silent, or nothing tells its offset."""
        if at_s - self.at_s > _FRESH_S:
            return None
        others_m = self._offsets_of_others(at_s, fleet)
        if self.offset_m is not None and self.learnt_s >= _LEAST_LEARNT_S:
            change_m, sigma_m = self._change_of_offset(others_m)
            return PressureHeight(self.altitude_m + self.offset_m + change_m, sigma_m)
        if not others_m:
            return None
        climb_m = self.altitude_m - fmean(other.altitude_m for other in others_m)
        sigma_m = hypot(_OTHER_SENSOR_SIGMA_M, _SCALE_SIGMA * climb_m)
        return PressureHeight(self.altitude_m + fmean(offset_m for offset_m, _ in others_m.values()), sigma_m)

    def _change_of_offset(self, others_m: Mapping[Barometer, tuple[float, float]]) -> tuple[float, float]:
        """Return by how much the offset has changed since it was learnt, and its 1-sigma, m.

        That of a vehicle that climbs by c changes by w + s c, with the weather w and the scale s of the air, which are those of
        all: least squares over the others, with the priors of both.
        """
        known_m = self.others_m
        changes = [
            (offset_m - known_m[other][0], altitude_m - known_m[other][1])
            for other, (offset_m, altitude_m) in others_m.items()
            if other in known_m
        ]
        climb_m = self.altitude_m - self.learnt_altitude_m
        if not changes:
            return 0.0, _SCALE_SIGMA * abs(climb_m)
        each = _OTHER_OFFSET_SIGMA_M**-2
        ww = _WEATHER_SIGMA_M**-2 + each * len(changes)
        ws = each * sum(c for _, c in changes)
        ss = _SCALE_SIGMA**-2 + each * sum(c * c for _, c in changes)
        w, s = each * sum(m for m, _ in changes), each * sum(m * c for m, c in changes)
        determinant = ww * ss - ws * ws
        change_m = ((ss * w - ws * s) + climb_m * (ww * s - ws * w)) / determinant
        return change_m, sqrt((ss - 2.0 * climb_m * ws + climb_m * climb_m * ww) / determinant)

    def _offsets_of_others(self, at_s: float, fleet: Iterable[Barometer]) -> dict[Barometer, tuple[float, float]]:
        return {
            other: (other.offset_m, other.learnt_altitude_m)
            for other in fleet
            if other is not self
            and other.offset_m is not None
            and other.learnt_s >= _LEAST_LEARNT_S
            and at_s - other.offset_at_s <= _FRESH_S
        }


class KnownPlace(NamedTuple):
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
class AltitudeBuilder:
    """Builds the altitudes of one vehicle.

    There is none before anything tells where the vehicle is: the earth falls away from the frame's plane.

    `datum_sigma_m` is how uncertain its height is beyond its barometer, where that began with a fix of ours. `_place` is where it
    was while trusted, `_near` where a trusted vehicle was that is in range of it.
    """

    barometer: Barometer = field(default_factory=Barometer)
    _height_reported_at_s: float | None = None
    _datum_sigma_m: float = 0.0
    _place: KnownPlace | None = None
    _near: KnownPlace | None = None

    def add_trusted_position(self, message: GlobalPosition, reported: PositionMeasurement, fleet: Iterable[Barometer]) -> None:
        """Add its position while it is trusted: it calibrates the barometer, and tells where its peers are."""
        now_s = message.received_at_s
        self._datum_sigma_m, self._height_reported_at_s = 0.0, now_s
        self.barometer.learn(message.alt_msl_m, now_s, fleet)
        east_m, north_m, _ = reported.position_enu_m
        self._place = KnownPlace(east_m, north_m, 0.0, now_s, hypot(message.vn_mps, message.ve_mps))

    def add_range(self, message: PeerRange, other_end: KnownPlace | None) -> None:
        """Add a range, whichever end measured it: the vehicle is as far from the other end."""
        if other_end is not None:
            e, n, at_s = other_end.east_m, other_end.north_m, message.received_at_s
            self._near = KnownPlace(e, n, message.range_m, at_s, _UNKNOWN_SPEED_MPS)

    def recent_place(self, now_s: float) -> KnownPlace | None:
        """Return where it was of late while trusted; None where that is not known."""
        place = self._place
        return place if place is not None and now_s - place.at_s <= _PLACED_FOR_S else None

    def from_position(
        self,
        message: GlobalPosition,
        measured: ServiceTime,
        frame: LocalFrame,
        fleet: Iterable[Barometer],
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
        now_s = message.received_at_s
        if self._height_reported_at_s is None or booted_at_s > self._height_reported_at_s:
            self._datum_sigma_m = sent_fix.sigma_v_m if sent_fix is not None and sent_fix.at_s > booted_at_s else 0.0
        self._height_reported_at_s = now_s
        if self.barometer.height(now_s, fleet) is not None:
            return None
        sigma_m = hypot(altitude_sigma_m, self._datum_sigma_m, message.vd_mps * measured.sigma_s)
        return self._altitude(message, message.alt_msl_m, sigma_m, frame, measured, located_enu_m)

    def sigma_m(self, now_s: float, fleet: Iterable[Barometer], *, altitude_sigma_m: float) -> float:
        """Return the 1-sigma that its altitude would have without its GPS while it is trusted, m."""
        height = self.barometer.height(now_s, fleet)
        return hypot(altitude_sigma_m, height.sigma_m) if height is not None else altitude_sigma_m

    def from_pressure(
        self,
        message: Pressure,
        measured: ServiceTime,
        frame: LocalFrame,
        fleet: Iterable[Barometer],
        *,
        altitude_sigma_m: float,
        located_enu_m: tuple[float, float] | None,
    ) -> AltitudeMeasurement | None:
        """Build the altitude by its barometer, to which the pressure has been added.

        None where nothing tells what the pressure means, or where the vehicle is.
        """
        height = self.barometer.height(message.received_at_s, fleet)
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
        now_s = message.received_at_s
        places = [KnownPlace(*located_enu_m, 0.0, now_s, 0.0)] if located_enu_m is not None else [self._place, self._near]
        place = min((p for p in places if p is not None), key=lambda p: p.sigma_at(now_s), default=None)
        if place is None:
            return None
        up_m = frame.up_from_height(place.east_m, place.north_m, alt_msl_m)
        fallen_m = hypot(place.east_m, place.north_m) * place.sigma_at(now_s) / _EARTH_RADIUS_M
        return AltitudeMeasurement(message.sysid, measured.at_s, now_s, up_m, hypot(sigma_m, fallen_m))
