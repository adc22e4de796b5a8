"""Calibration of a vehicle's air data with GPS: wind, airspeed and heading errors, gust level.

A vehicle with GPS that nobody ranges has no states, only its latest reports. Three seconds of them show the wind of one gust. So
every few seconds the velocity of a report is compared with the air data, by eq. (13), in a filter of four components alone.
An initialisation begins with what it found before the reports that it replays.
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
_MOST_RATIO = 4.0
"""Chosen: one wrong attitude doubles the level at most."""


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
