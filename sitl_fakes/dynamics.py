"""One aircraft's flight: lateral dynamics, aileron and rudder actuators, and the heading hold of Qu & Zhang's Figure 4.

Units: rad, rad/s, m, s. Heading `psi` is from the frame's north, clockwise; positions are east and north in metres.

The aerodynamics are the linear lateral model of `airframe`. Gravity and the Euler angles are those of a level turn at any
bank, so that the turn rate is g tan(phi) / V as in flight; about wings-level the whole reduces to the published linear
model (a test compares the two matrices).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl_fakes.airframe import GRAVITY_MPS2, aerosonde

_ACTUATOR_TIME_CONSTANT_S = 0.05
_DEFLECTION_LIMIT_RAD = math.radians(30.0)
_ROLL_TIME_CONSTANT_S = 0.3
_ROLL_RATE_SHARE = 0.2
_YAW_DAMPING_PER_S = 3.0
_BANK_LIMIT_RAD = math.radians(45.0)
_HEADING_RATE_PER_S = 0.6

State = tuple[float, float, float, float, float, float, float, float, float]


def wrap_pi(angle_rad: float) -> float:
    """Return the angle brought into [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def turn_radius_m(airspeed_mps: float) -> float:
    """Radius (m) of the tightest turn: V^2 / (g tan(bank limit))."""
    return airspeed_mps**2 / (GRAVITY_MPS2 * math.tan(_BANK_LIMIT_RAD))


@dataclass(frozen=True, slots=True)
class FlightState:
    """What one aircraft does at one moment: position east and north (m), attitude (rad), rates (rad/s), deflections (rad)."""

    east_m: float
    north_m: float
    beta_rad: float
    p_radps: float
    r_radps: float
    phi_rad: float
    psi_rad: float
    aileron_rad: float
    rudder_rad: float


class LateralAircraft:
    """An aircraft at constant airspeed under its heading hold; `step` moves it by one time step (fourth-order Runge-Kutta).

    The heading hold (Fig. 4): heading error times a gain gives the bank that turns at 0.6 rad/s per rad of error,
    limited to 45 degrees; bank error and roll rate drive the aileron. The rudder is driven by the yaw rate beyond the
    turn's own (a yaw damper that does not fight a steady turn). Gains follow the derivatives, so that the response is the
    same at every airspeed.
    """

    def __init__(self, east_m: float, north_m: float, heading_rad: float, airspeed_mps: float) -> None:
        self.airspeed_mps = airspeed_mps
        self.derivatives = aerosonde(airspeed_mps)
        self._heading_gain = airspeed_mps * _HEADING_RATE_PER_S / GRAVITY_MPS2
        d = self.derivatives
        self._k_rate = _ROLL_RATE_SHARE * -d.l_p / d.l_da
        self._k_bank = (-d.l_p + self._k_rate * d.l_da) / (d.l_da * _ROLL_TIME_CONSTANT_S)
        self._k_yaw = -_YAW_DAMPING_PER_S / d.n_dr
        self._state: State = (east_m, north_m, 0.0, 0.0, 0.0, 0.0, heading_rad, 0.0, 0.0)

    @property
    def state(self) -> FlightState:
        """The state now."""
        return FlightState(*self._state)

    def step(self, heading_cmd_rad: float, step_s: float, wind_east_mps: float = 0.0, wind_north_mps: float = 0.0) -> None:
        """Fly one step towards a commanded heading (rad, from the frame's north), in a wind that blows towards east, north."""
        bank_cmd = math.atan(self._heading_gain * wrap_pi(heading_cmd_rad - self._state[6]))
        bank_cmd = max(-_BANK_LIMIT_RAD, min(_BANK_LIMIT_RAD, bank_cmd))
        x = self._state
        h = step_s
        k1 = self.rates(x, bank_cmd, wind_east_mps, wind_north_mps)
        k2 = self.rates(_ahead(x, k1, 0.5 * h), bank_cmd, wind_east_mps, wind_north_mps)
        k3 = self.rates(_ahead(x, k2, 0.5 * h), bank_cmd, wind_east_mps, wind_north_mps)
        k4 = self.rates(_ahead(x, k3, h), bank_cmd, wind_east_mps, wind_north_mps)
        e, n, b, p, r, phi, psi, da, dr = (
            xi + h / 6.0 * (a + 2.0 * b + 2.0 * c + d) for xi, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)
        )
        self._state = (e, n, b, p, r, phi, wrap_pi(psi), da, dr)

    def rates(self, x: State, bank_cmd_rad: float, wind_east_mps: float, wind_north_mps: float) -> State:
        """Time derivative of the state under a commanded bank: kinematics (34), lateral model, actuators, inner loops."""
        _, _, beta, p, r, phi, psi, da, dr = x
        d, v = self.derivatives, self.airspeed_mps
        gravity_turn = GRAVITY_MPS2 * math.sin(phi) / v
        aileron_cmd = self._k_bank * (bank_cmd_rad - phi) - self._k_rate * p
        rudder_cmd = -self._k_yaw * (gravity_turn - r)
        limit = _DEFLECTION_LIMIT_RAD
        aileron_cmd = max(-limit, min(limit, aileron_cmd))
        rudder_cmd = max(-limit, min(limit, rudder_cmd))
        return (
            v * math.sin(psi + beta) + wind_east_mps,
            v * math.cos(psi + beta) + wind_north_mps,
            d.y_beta * beta + d.y_p * p + d.y_r * r + d.y_da * da + d.y_dr * dr + gravity_turn,
            d.l_beta * beta + d.l_p * p + d.l_r * r + d.l_da * da + d.l_dr * dr,
            d.n_beta * beta + d.n_p * p + d.n_r * r + d.n_da * da + d.n_dr * dr,
            p,
            r / math.cos(phi),
            (aileron_cmd - da) / _ACTUATOR_TIME_CONSTANT_S,
            (rudder_cmd - dr) / _ACTUATOR_TIME_CONSTANT_S,
        )


def _ahead(x: State, rate: State, by_s: float) -> State:
    a, b, c, d, e, f, g, h, i = (xi + ri * by_s for xi, ri in zip(x, rate, strict=True))
    return a, b, c, d, e, f, g, h, i
