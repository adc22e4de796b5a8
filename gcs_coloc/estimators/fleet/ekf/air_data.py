"""Air data of a vehicle: their calibration with GPS, and their check against its way over ground.

Calibration finds the wind, the errors of airspeed and heading, and the level of gusts. A vehicle with GPS that nobody ranges has
no states, only its latest reports. Three seconds of them show the wind of one gust. So every few seconds the velocity of a report
is compared with the air data, by eq. (13), in a filter of four components alone. An initialisation begins with what it found
before the reports that it replays.

The check is of a denied vehicle. A pitot tube that ices up must not carry the vehicle through a gap. The filter itself cannot
tell: what air data pull at, ranges pull back, and its process noise grows with either. So every few seconds the way between two
positions is compared with the way through the air, by the calibration that was made with GPS. Where no wind and no errors explain
the difference, the air data are refused until the error of the airspeed is known to be small. On one course any error passes for
wind: that takes a turn. Without ranges the positions are uncertain, and only an airspeed that leaps is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import learned_log_level
from gcs_coloc.estimators.fleet.ekf.measurement_models import air_residuals
from gcs_coloc.estimators.fleet.settings import FleetSettings

EVERY_S = 4.0
"""Chosen: twice `air_noise_time_s`, after which gusts near the ground are other ones."""

_FIRST_LOG_LEVEL = math.log(2.0)
"""Chosen: gusts of 1.1 m/s until the level is learned: one too large costs accuracy for half a minute, one too small honesty."""
_MOST_RATIO = 4.0  # chosen: one wrong attitude doubles the level at most


class GroundVelocity(NamedTuple):
    """A velocity over ground, and its 1-sigma on each axis, m/s."""

    east_mps: float
    north_mps: float
    sigma_mps: float


@dataclass(frozen=True, slots=True)
class AirCalibration:
    """The wind, the errors of airspeed and heading, and the level of gusts, as learned so far.

    The components of `mean` (4,) and `covariance` (4, 4) are the wind east and north, m/s, the airspeed error, m/s, and the
    heading error, rad. `nis` is that of the newest sample, with two degrees of freedom.
    """

    at_s: float
    mean: FloatArray
    covariance: FloatArray
    log_level: float
    samples: int = 0
    nis: float = 0.0

    @classmethod
    def initial(cls, at_s: float, s: FleetSettings, airspeed_sigma_mps: float | None = None) -> AirCalibration:
        """Return the calibration before any sample: the steady state of eq. (7).

        `airspeed_sigma_mps` replaces the sigma of the airspeed error if it is given.
        """
        covariance = np.diag(steady_air_m2(s))
        if airspeed_sigma_mps is not None:
            covariance[2, 2] = airspeed_sigma_mps**2
        return cls(at_s, np.zeros(4), covariance, _FIRST_LOG_LEVEL)

    def predicted(self, at_s: float, s: FleetSettings) -> AirCalibration:
        """Return the calibration at a later time, eq. (7)."""
        kept = np.exp(-max(at_s - self.at_s, 0.0) / _times_s(s))
        steady = np.diag(steady_air_m2(s) * (1.0 - kept * kept))
        covariance = np.outer(kept, kept) * self.covariance + steady
        return replace(self, at_s=at_s, mean=kept * self.mean, covariance=covariance)

    def updated(
        self, at_s: float, ground: GroundVelocity, airspeed_mps: float, yaw_rad: float, s: FleetSettings
    ) -> AirCalibration:
        """Return the calibration after one more sample, eq. (13) and (30).

        The sample is a velocity over ground, with the horizontal airspeed and the heading at that time.
        """
        before = self.predicted(at_s, s)
        x, P = before.mean, before.covariance
        through_air = ground.east_mps - x.item(0), ground.north_mps - x.item(1)
        air = air_residuals(*through_air, airspeed_mps, yaw_rad, P.item(0, 0) + P.item(1, 1))
        # H: along the nose (airspeed), across it (heading).
        H = np.array([[-air.east, -air.north, 1.0, 0.0], [-air.north, air.east, 0.0, air.speed_mps]])
        innovation = np.array((air.along_mps - x[2], air.across_mps - air.speed_mps * x[3]))
        R = math.exp(before.log_level) * s.air_noise_mps**2 + ground.sigma_mps**2
        S = H @ P @ H.T + R * np.eye(2)
        gain = np.linalg.solve(S, H @ P).T
        nis = float(innovation @ np.linalg.solve(S, innovation))
        time_s = s.noise_level_time_s
        # The first sample finds the wind, whatever the gusts.
        since_s = max(EVERY_S, time_s / (1.0 + self.samples)) if self.samples else 0.0
        gusts = (s.least_noise_level, s.most_noise_level)
        log_level = learned_log_level(before.log_level, min(0.5 * nis, _MOST_RATIO), since_s, time_s, gusts)
        return AirCalibration(at_s, x + gain @ innovation, P - gain @ S @ gain.T, log_level, self.samples + 1, nis)


def steady_air_m2(s: FleetSettings) -> FloatArray:
    """Return the steady-state variances (4,) of the wind and of the air data errors, eq. (7).

    They are those of the wind east and north, the airspeed error and the heading error.
    """
    return np.array((s.wind_sigma_mps, s.wind_sigma_mps, s.airspeed_sigma_mps, s.heading_sigma_rad)) ** 2


def _times_s(s: FleetSettings) -> FloatArray:
    return np.array((s.wind_time_s, s.wind_time_s, s.air_error_time_s, s.air_error_time_s))


_SUSPICIOUS_NIS = 9.2  # chi-square with two degrees of freedom: one of a hundred. The calibration learns nothing from beyond it
_LEAST_SAMPLES = 5  # chosen: of fewer, the level of gusts is not known well enough for a suspicion
_MOST_NIS = 27.6  # of suspicious windows in a row, together: one of a million, as one beyond it, two beyond the half or three
_TELLING_SIGMA_MPS = 2.0  # chosen: a tenth of the airspeed of small planes; a way that is known no better agrees with anything
_UNKNOWN_ERROR_MPS = 20.0  # chosen: the airspeed of small planes, all of which may be missing
_RIGHT_SIGMAS = 3.0  # chosen: refused air data are used again once their error is known to be within three of its usual sigmas
_LEAP_MPS = 6.0
"""Chosen: between two messages airspeeds change by 1.8 m/s at most in recorded flights, by 4.7 in simulated gusts of 4 m/s."""
_LONGEST_GAP_S = 0.5  # chosen: as long as an attitude holds; over a longer one a turn is not known


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
        """Return the check after a reflection: no way leads there, so the window begins anew."""
        return replace(self, window=None)


def _is_right(calibration: AirCalibration, s: FleetSettings) -> bool:
    """Whether the error of the airspeed is known to be small."""
    error_mps, sigma_mps = calibration.mean.item(2), math.sqrt(calibration.covariance.item(2, 2))
    return abs(error_mps) + 2.0 * sigma_mps <= _RIGHT_SIGMAS * s.airspeed_sigma_mps


AIR_UNSUSPECTED = AirCheck()
