"""Height from air pressure: a barometer that no position of ours comes back through.

The height that an autopilot reports is its filter's: while the vehicle is aided it may hold what we sent. The pressure altitude
of SCALED_PRESSURE is the sensor's own. It differs from the height above mean sea level by the weather and by the sensor: that
offset is learnt while the vehicle's GPS is trusted. What the weather does to it afterwards is seen in the offsets of the
vehicles that are still trusted.

Source of the pressure altitude: International Standard Atmosphere (ISO 2533), the layer up to 11 km.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, hypot
from statistics import fmean
from typing import NamedTuple

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
