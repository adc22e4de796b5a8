"""The autopilot's own horizontal navigation.

Airspeed and heading carry it on. GPS corrects position, velocity and the wind estimate.

Per axis a Kalman filter with the states position (m) and wind (m/s); velocity over ground is airspeed along heading plus wind.
East and north are alike and independent, so they share one covariance (2, 2). Without GPS this is dead reckoning: errors of
airspeed and heading that the wind state had absorbed come out with the next turn, and a change of wind goes unseen, as on a real
aircraft. As EKF3 and EKF2 do, it refuses what is off by more than a gate of some sigma, and takes the measurement over whole
where nothing was accepted for some seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl_fakes.receivers import GpsFix

_GATE_SIGMA = 5.0  # source: EK3_POS_I_GATE, its default
_POSITION_NOISE_M2PS = 0.05  # chosen: inertial navigation between fixes
_WIND_NOISE_M2PS3 = 0.02  # chosen: twice EK3_WIND_P_NSE squared
_LEAST_POSITION_SIGMA_M = 0.5  # source: EK3_POSNE_M_NSE, its default
_LEAST_VELOCITY_SIGMA_MPS = 0.5  # source: EK3_VELNE_M_NSE, a plane's default
_FIRST_WIND_SIGMA_MPS = 5.0  # chosen: wind that small aircraft fly in
_BAROMETER_TIME_S = 5.0  # chosen: below the 7 to 13 s in which a real ArduPlane's altitude swung (0.1 in the loop)


@dataclass(slots=True)
class _Covariance:
    """Variances of position (m^2) and wind (m^2/s^2), and their covariance (m^2/s).

    They are the same on both axes.
    """

    pp: float
    pw: float
    ww: float


class HeightFilter:
    """EKF3's height: the barometer's, pulled away by a receiver's vertical velocity.

    The velocity pulls only where it is fused.

    The error e follows de/dt = (velocity given - true climb) - e / tau: the filter integrates the velocity and leans on the
    barometer. A velocity that was worked out of the height that comes out of here closes a loop.
    """

    def __init__(self) -> None:
        self._given_up_mps: float | None = None
        self._error_m = 0.0
        self._error_rate_mps = 0.0

    @property
    def error_m(self) -> float:
        """Height above the barometer's, m."""
        return self._error_m

    @property
    def climb_error_mps(self) -> float:
        """Rate of climb above the true one, m/s."""
        return self._error_rate_mps

    def fuse(self, up_mps: float | None) -> None:
        """Take a receiver's vertical velocity (up, m/s); None: it brings none, or it is not fused."""
        self._given_up_mps = up_mps

    def predict(self, climb_mps: float, step_s: float) -> None:
        """Carry the height over a step with the true rate of climb (m/s), which its accelerometers show."""
        given = 0.0 if self._given_up_mps is None else self._given_up_mps - climb_mps
        self._error_rate_mps = given - self._error_m / _BAROMETER_TIME_S
        self._error_m += self._error_rate_mps * step_s


class Navigation:
    """Position and velocity as one filter believes them (east, north; m, m/s).

    Before the first fix there is no position.

    A measurement is taken over whole where nothing was accepted for `reset_after_s`. The heading that it is given (rad) is off
    by `heading_error_rad` more for this filter. `position_ratio` and `velocity_ratio` are the last innovations over the gate,
    squared: above 1 they are refused (EKF3's posTestRatio and velTestRatio).
    """

    def __init__(self, reset_after_s: float, heading_error_rad: float = 0.0) -> None:
        self._reset_after_s = reset_after_s
        self._heading_error_rad = heading_error_rad
        self.position_m: tuple[float, float] | None = None
        self.position_ratio = self.velocity_ratio = 0.0
        self._air: tuple[float, float] | None = None  # not measured yet
        self._wind = [0.0, 0.0]
        self._p = _Covariance(0.0, 0.0, _FIRST_WIND_SIGMA_MPS**2)
        self._position_at_s = -math.inf
        self._velocity_at_s = -math.inf

    @property
    def velocity_mps(self) -> tuple[float, float]:
        """Velocity over ground, east and north, m/s."""
        air_east, air_north = self._air or (0.0, 0.0)
        return air_east + self._wind[0], air_north + self._wind[1]

    @property
    def wind_mps(self) -> tuple[float, float]:
        """Estimated wind, towards east and north, m/s."""
        return self._wind[0], self._wind[1]

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position that the filter believes, per axis, m."""
        return math.sqrt(self._p.pp)

    @property
    def refusing(self) -> bool:
        """Whether the last position given was refused."""
        return self.position_ratio > 1.0

    def since_position_s(self, at_s: float) -> float:
        """Time since a position was last accepted, s (infinite if never)."""
        return at_s - self._position_at_s

    def predict(self, airspeed_mps: float, heading_rad: float, step_s: float) -> None:
        """Carry the estimate over a step with the measured airspeed (m/s) and heading (rad from north)."""
        heading_rad += self._heading_error_rad
        self._air = (airspeed_mps * math.sin(heading_rad), airspeed_mps * math.cos(heading_rad))
        if self.position_m is None:
            return
        ve, vn = self.velocity_mps
        self.position_m = (self.position_m[0] + ve * step_s, self.position_m[1] + vn * step_s)
        p = self._p
        p.pp += 2.0 * p.pw * step_s + p.ww * step_s**2 + _POSITION_NOISE_M2PS * step_s
        p.pw += p.ww * step_s
        p.ww += _WIND_NOISE_M2PS3 * step_s

    def correct(self, fix: GpsFix, at_s: float) -> None:
        """Fuse a fix that passed the quality checks.

        Its position is brought forward by its age and fused first, then its velocity.
        """
        ve, vn, _ = fix.velocity_enu_mps
        seen = _brought_forward(fix)
        first = self.position_m is None
        self.correct_position(seen, fix.h_acc_m or 0.0, at_s)
        if first:
            self._take_velocity((ve, vn), at_s)
        else:
            self._correct_velocity((ve, vn), max(fix.speed_acc_mps or 0.0, _LEAST_VELOCITY_SIGMA_MPS), at_s)

    def correct_position(
        self, seen_m: tuple[float, float], sigma_m: float, at_s: float, *, gate_sigma: float = _GATE_SIGMA, may_reset: bool = True
    ) -> bool:
        """Fuse a position (east, north, m) with its standard deviation (m); True where it was accepted.

        What is beyond the gate is taken over whole after a while, if `may_reset`.
        """
        sigma = max(sigma_m, _LEAST_POSITION_SIGMA_M)
        if self.position_m is None:
            self.take_position(seen_m, sigma, at_s)
            return True
        innovation = (seen_m[0] - self.position_m[0], seen_m[1] - self.position_m[1])
        spread = self._p.pp + sigma**2
        self.position_ratio = (innovation[0] ** 2 + innovation[1] ** 2) / (gate_sigma**2 * spread)
        if not self.refusing:
            self._update(innovation, self._p.pp / spread, self._p.pw / spread, spread)
            self._position_at_s = at_s
        elif may_reset and self.since_position_s(at_s) > self._reset_after_s:
            self.take_position(seen_m, sigma, at_s)
        return not self.refusing

    def correct_range(
        self,
        there_m: tuple[float, float],
        below_m: float,
        range_m: float,
        sigma_m: float,
        age_s: float,
        at_s: float,
        *,
        gate_sigma: float,
    ) -> bool:
        """Fuse a slant range (m) to a place (east, north, m); True where it was accepted.

        The place lies `below_m` lower. The range is `age_s` old.

        Position and wind move along the line to it. One of the two axes that share a covariance is known better by it.
        """
        if self.position_m is None:
            return False
        ve, vn = self.velocity_mps
        east, north = self.position_m[0] - ve * age_s - there_m[0], self.position_m[1] - vn * age_s - there_m[1]
        slant = math.sqrt(east * east + north * north + below_m * below_m)
        if slant < 1.0:
            return False
        h = (east / slant, north / slant)
        spread = (h[0] ** 2 + h[1] ** 2) * self._p.pp + sigma_m**2
        innovation = range_m - slant
        if abs(innovation) > gate_sigma * math.sqrt(spread):
            return False
        pull = innovation / spread
        self.position_m = (self.position_m[0] + self._p.pp * h[0] * pull, self.position_m[1] + self._p.pp * h[1] * pull)
        self._wind = [w + self._p.pw * x * pull for w, x in zip(self._wind, h, strict=True)]
        p, share = self._p, 0.5 * (h[0] ** 2 + h[1] ** 2) / spread
        p.pp, p.pw, p.ww = p.pp - share * p.pp**2, p.pw - share * p.pp * p.pw, p.ww - share * p.pw**2
        self._position_at_s = at_s
        return True

    def move_to(self, fix: GpsFix) -> None:
        """Set the position to a fix, brought forward by its age; how well it is known stays as it was."""
        if self.position_m is not None:
            self.position_m = _brought_forward(fix)

    def apply_estimate(self, position_m: tuple[float, float], sigma_m: float, age_s: float) -> None:
        """Set the position from outside, and keep the wind.

        It is that of MAV_CMD_EXTERNAL_POSITION_ESTIMATE: east and north in m as they were `age_s` ago.
        """
        ve, vn = self.velocity_mps
        self.position_m = (position_m[0] + ve * age_s, position_m[1] + vn * age_s)
        self._p.pp, self._p.pw = max(sigma_m, _LEAST_POSITION_SIGMA_M) ** 2, 0.0

    def forget_wind(self) -> None:
        """Hold the wind for none, and for as uncertain as at first."""
        self._wind = [0.0, 0.0]
        self._p.pw, self._p.ww = 0.0, _FIRST_WIND_SIGMA_MPS**2

    def _correct_velocity(self, seen_mps: tuple[float, float], sigma_mps: float, at_s: float) -> None:
        ve, vn = self.velocity_mps
        innovation = (seen_mps[0] - ve, seen_mps[1] - vn)
        spread = self._p.ww + sigma_mps**2
        self.velocity_ratio = (innovation[0] ** 2 + innovation[1] ** 2) / (_GATE_SIGMA**2 * spread)
        if self.velocity_ratio <= 1.0:
            self._update(innovation, self._p.pw / spread, self._p.ww / spread, spread)
            self._velocity_at_s = at_s
        elif at_s - self._velocity_at_s > self._reset_after_s:
            self._take_velocity(seen_mps, at_s)

    def _update(self, innovation: tuple[float, float], gain_position: float, gain_wind: float, spread: float) -> None:
        assert self.position_m is not None
        e, n = self.position_m
        self.position_m = (e + gain_position * innovation[0], n + gain_position * innovation[1])
        self._wind = [w + gain_wind * v for w, v in zip(self._wind, innovation, strict=True)]
        p = self._p
        p.pp -= gain_position**2 * spread
        p.pw -= gain_position * gain_wind * spread
        p.ww -= gain_wind**2 * spread

    def take_position(self, position_m: tuple[float, float], sigma_m: float, at_s: float) -> None:
        """Take a position (east, north, m) over whole, with its standard deviation (m); the wind is kept."""
        self.position_m = position_m
        self._p.pp, self._p.pw = sigma_m**2, 0.0
        self._position_at_s = at_s
        self.position_ratio = 0.0

    def _take_velocity(self, velocity_mps: tuple[float, float], at_s: float) -> None:
        if self._air is None:
            return  # without the airspeed beside it, all of the velocity would be taken for wind
        self._wind = [velocity_mps[0] - self._air[0], velocity_mps[1] - self._air[1]]
        self._p.pw, self._p.ww = 0.0, _FIRST_WIND_SIGMA_MPS**2
        self._velocity_at_s = at_s
        self.velocity_ratio = 0.0


def _brought_forward(fix: GpsFix) -> tuple[float, float]:
    (east, north, _), (ve, vn, _) = fix.position_enu_m, fix.velocity_enu_mps
    return east + ve * fix.age_s, north + vn * fix.age_s
