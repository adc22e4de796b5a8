"""Check of a denied vehicle's air data against its way over ground.

A pitot tube that ices up must not carry the vehicle through a gap. The filter itself cannot tell: what air data pull at, ranges
pull back, and its process noise grows with either. So every few seconds the way between two positions is compared with the way
through the air, by the calibration that was made with GPS. Where no wind and no errors explain the difference, the air data are
refused until the error of the airspeed is known to be small. On one course any error passes for wind: that takes a turn. Without
ranges the positions are uncertain, and only an airspeed that leaps is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from gcs_coloc.estimators.fleet.ekf.air_calibration import EVERY_S, AirCalibration, GroundVelocity
from gcs_coloc.estimators.fleet.settings import FleetSettings

_SUSPICIOUS_NIS = 9.2
"""Chi-square with two degrees of freedom: one of a hundred. The calibration learns nothing from beyond it."""
_LEAST_SAMPLES = 5
"""Chosen: of fewer, the level of gusts is not known well enough for a suspicion."""
_MOST_NIS = 27.6
"""Of suspicious windows in a row, together: one of a million, as one beyond it, two beyond the half or three."""
_TELLING_SIGMA_MPS = 2.0
"""Chosen: a tenth of the airspeed of small planes; a way that is known no better agrees with anything."""
_UNKNOWN_ERROR_MPS = 20.0
"""Chosen: the airspeed of small planes, all of which may be missing."""
_RIGHT_SIGMAS = 3.0
"""Chosen: refused air data are used again once their error is known to be within three of its usual sigmas."""
_LEAP_MPS = 6.0
"""Chosen: between two messages airspeeds change by 1.8 m/s at most in recorded flights, by 4.7 in simulated gusts of 4 m/s."""
_LONGEST_GAP_S = 0.5
"""Chosen: as long as an attitude holds; over a longer one a turn is not known."""


class Place(NamedTuple):
    """Where a vehicle is, east and north, m, and the 1-sigma of its worst direction, m."""

    east_m: float
    north_m: float
    sigma_m: float


class AirWindow(NamedTuple):
    """The way through the air since a place, east and north, m, with the newest velocity through it, m/s."""

    began_s: float
    place: Place
    at_s: float
    east_mps: float
    north_mps: float
    east_m: float = 0.0
    north_m: float = 0.0

    def after(self, at_s: float, east_mps: float, north_mps: float) -> AirWindow:
        """Return the window after one more velocity, integrated by trapezoids."""
        half_s = 0.5 * (at_s - self.at_s)
        east_m, north_m = self.east_m + half_s * (self.east_mps + east_mps), self.north_m + half_s * (self.north_mps + north_mps)
        return AirWindow(self.began_s, self.place, at_s, east_mps, north_mps, east_m, north_m)


@dataclass(frozen=True, slots=True)
class AirCheck:
    """Whether the air data of one vehicle are refused.

    `calibration` is what the windows since the loss, or since the refusal, have shown; None before the first is over.
    `suspicion` is the NIS of the suspicious windows of late, together.
    """

    is_refused: bool = False
    calibration: AirCalibration | None = None
    window: AirWindow | None = None
    suspicion: float = 0.0

    def updated(
        self, at_s: float, place: Place, airspeed_mps: float, yaw_rad: float, known: AirCalibration | None, s: FleetSettings
    ) -> AirCheck:
        """Return the check after air data at a place.

        The air data are the horizontal airspeed and the heading. `known` is the calibration with GPS, if there is one.
        """
        east_mps, north_mps = airspeed_mps * math.sin(yaw_rad), airspeed_mps * math.cos(yaw_rad)
        window = self.window
        if window is None or not 0.0 <= at_s - window.at_s <= _LONGEST_GAP_S:
            return replace(self, window=AirWindow(at_s, place, at_s, east_mps, north_mps))
        if abs(airspeed_mps - math.hypot(window.east_mps, window.north_mps)) > _LEAP_MPS:
            return self._refused(AirWindow(at_s, place, at_s, east_mps, north_mps), s)
        window = window.after(at_s, east_mps, north_mps)
        span_s = at_s - window.began_s
        if span_s < EVERY_S:
            return replace(self, window=window)
        began, air_m = window.place, (window.east_m, window.north_m)
        window = AirWindow(at_s, place, at_s, east_mps, north_mps)
        sigma_mps = math.hypot(place.sigma_m, began.sigma_m) / span_s
        if sigma_mps > _TELLING_SIGMA_MPS:
            return replace(self, window=window)
        ground_east_m, ground_north_m = place.east_m - began.east_m, place.north_m - began.north_m
        ground = GroundVelocity(ground_east_m / span_s, ground_north_m / span_s, sigma_mps)
        before = self.calibration or known or AirCalibration.initial(at_s, s)
        after = before.updated(at_s, ground, math.hypot(*air_m) / span_s, math.atan2(*air_m), s)
        if after.nis <= (_SUSPICIOUS_NIS if before.samples >= _LEAST_SAMPLES else _MOST_NIS):
            return AirCheck(self.is_refused and not _is_right(after, s), after, window)
        suspicion = self.suspicion + after.nis
        if suspicion <= _MOST_NIS:
            return replace(self, window=window, suspicion=suspicion)
        return self._refused(window, s)

    def _refused(self, window: AirWindow, s: FleetSettings) -> AirCheck:
        return AirCheck(True, AirCalibration.initial(window.at_s, s, _UNKNOWN_ERROR_MPS), window)

    def reflected(self) -> AirCheck:
        """Return the check for a vehicle whose states were reflected.

        No way leads to the reflected position, so the window begins anew.
        """
        return replace(self, window=None)


def _is_right(calibration: AirCalibration, s: FleetSettings) -> bool:
    """Whether the error of the airspeed is known to be small."""
    error_mps, sigma_mps = calibration.mean.item(2), math.sqrt(calibration.covariance.item(2, 2))
    return abs(error_mps) + 2.0 * sigma_mps <= _RIGHT_SIGMAS * s.airspeed_sigma_mps


AIR_UNSUSPECTED = AirCheck()
