"""The flight of one aircraft: lateral dynamics, actuators and heading hold.

The heading hold is that of Qu & Zhang's Figure 4. The actuators are aileron and rudder.

Units: rad, rad/s, m, s. Heading `psi` is from the frame's north, clockwise; positions are east and north in metres.

The aerodynamics are a linear lateral model with the Aerosonde's published coefficients. Gravity and the Euler angles are
those of a level turn at any bank, so that the turn rate is g tan(phi) / V as in flight; about wings-level the whole reduces
to the published linear model (a test compares the two matrices).

Source: R. W. Beard and T. W. McLain, "Small Unmanned Aircraft: Theory and Practice", Princeton University Press, 2012:
inertia products Gamma of Eq. (3.13), lateral moment coefficients of Eqs. (5.23)-(5.24) ff., linear lateral model of
Section 5.5.1 and Table 5.1; Aerosonde parameters of Appendix E, Table E.2, with the values of the book's later printings
(the authors' uavbook supplement), which differ from the first printing's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

GRAVITY_MPS2 = 9.80665  # source: standard gravity, ISO 80000-3
_MASS_KG = 11.0
_JX, _JZ, _JXZ = 0.8244, 1.759, 0.1204
_WING_AREA_M2 = 0.55
_SPAN_M = 2.8956
_AIR_DENSITY = 1.2682
_CY_BETA, _CL_BETA, _CN_BETA = -0.98, -0.13, 0.073
_CY_P, _CL_P, _CN_P = 0.0, -0.51, -0.069
_CY_R, _CL_R, _CN_R = 0.0, 0.25, -0.095
_CY_DA, _CL_DA, _CN_DA = 0.075, 0.17, -0.011
_CY_DR, _CL_DR, _CN_DR = 0.19, 0.0024, -0.069
_ACTUATOR_TIME_CONSTANT_S = 0.05  # chosen: a small servo
_DEFLECTION_LIMIT_RAD = math.radians(30.0)
_ROLL_TIME_CONSTANT_S = 0.3  # chosen: a small aircraft under control
_ROLL_RATE_SHARE = 0.2  # chosen: rolls without overshoot
_YAW_DAMPING_PER_S = 3.0  # chosen: damps the Dutch roll
_BANK_LIMIT_RAD = math.radians(45.0)
_HEADING_RATE_PER_S = 0.6  # chosen: a turn is flown within seconds
State = tuple[float, float, float, float, float, float, float, float, float]


def wrap_pi(angle_rad: float) -> float:
    """Return the angle brought into [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def turn_radius_m(airspeed_mps: float) -> float:
    """Radius (m) of the tightest turn: V^2 / (g tan(bank limit))."""
    return airspeed_mps**2 / (GRAVITY_MPS2 * math.tan(_BANK_LIMIT_RAD))


class FlightState(NamedTuple):
    """What one aircraft does at one moment.

    Position east and north (m), attitude (rad), rates (rad/s), deflections (rad).
    """

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
    """An aircraft at constant airspeed under its heading hold.

    `step` moves its `state` on by fourth-order Runge-Kutta.

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
        self.state = FlightState(east_m, north_m, 0.0, 0.0, 0.0, 0.0, heading_rad, 0.0, 0.0)

    def step(self, heading_cmd_rad: float, step_s: float, wind_east_mps: float = 0.0, wind_north_mps: float = 0.0) -> None:
        """Fly one step towards a commanded heading (rad, from the frame's north).

        The wind blows towards east and north.
        """
        bank_cmd = math.atan(self._heading_gain * wrap_pi(heading_cmd_rad - self.state.psi_rad))
        bank_cmd = max(-_BANK_LIMIT_RAD, min(_BANK_LIMIT_RAD, bank_cmd))
        x = self.state
        h = step_s
        k1 = self.rates(x, bank_cmd, wind_east_mps, wind_north_mps)
        k2 = self.rates(_ahead(x, k1, 0.5 * h), bank_cmd, wind_east_mps, wind_north_mps)
        k3 = self.rates(_ahead(x, k2, 0.5 * h), bank_cmd, wind_east_mps, wind_north_mps)
        k4 = self.rates(_ahead(x, k3, h), bank_cmd, wind_east_mps, wind_north_mps)
        sixth = h / 6.0
        e, n, b, p, r, phi, psi, da, dr = [
            xi + sixth * (a + 2.0 * b + 2.0 * c + d) for xi, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)
        ]
        self.state = FlightState(e, n, b, p, r, phi, wrap_pi(psi), da, dr)

    def rates(self, x: State, bank_cmd_rad: float, wind_east_mps: float, wind_north_mps: float) -> State:
        """Return the time derivative of the state under a commanded bank.

        It follows from the kinematics (34), the lateral model, the actuators and the inner loops.
        """
        _, _, beta, p, r, phi, psi, da, dr = x
        v, course = self.airspeed_mps, psi + beta
        y_beta, y_p, y_r, y_da, y_dr, l_beta, l_p, l_r, l_da, l_dr, n_beta, n_p, n_r, n_da, n_dr = self.derivatives
        gravity_turn = GRAVITY_MPS2 * math.sin(phi) / v
        aileron_cmd = self._k_bank * (bank_cmd_rad - phi) - self._k_rate * p
        rudder_cmd = -self._k_yaw * (gravity_turn - r)
        limit = _DEFLECTION_LIMIT_RAD
        aileron_cmd = max(-limit, min(limit, aileron_cmd))
        rudder_cmd = max(-limit, min(limit, rudder_cmd))
        return (
            v * math.sin(course) + wind_east_mps,
            v * math.cos(course) + wind_north_mps,
            y_beta * beta + y_p * p + y_r * r + y_da * da + y_dr * dr + gravity_turn,
            l_beta * beta + l_p * p + l_r * r + l_da * da + l_dr * dr,
            n_beta * beta + n_p * p + n_r * r + n_da * da + n_dr * dr,
            p,
            r / math.cos(phi),
            (aileron_cmd - da) / _ACTUATOR_TIME_CONSTANT_S,
            (rudder_cmd - dr) / _ACTUATOR_TIME_CONSTANT_S,
        )


def _ahead(x: State, rate: State, by_s: float) -> State:
    e, n, beta, p, r, phi, psi, da, dr = x
    e1, n1, beta1, p1, r1, phi1, psi1, da1, dr1 = rate
    return (
        e + e1 * by_s,
        n + n1 * by_s,
        beta + beta1 * by_s,
        p + p1 * by_s,
        r + r1 * by_s,
        phi + phi1 * by_s,
        psi + psi1 * by_s,
        da + da1 * by_s,
        dr + dr1 * by_s,
    )


class LateralDerivatives(NamedTuple):
    """Dimensional lateral derivatives at one airspeed, level flight, pitch angle zero (stability axes).

    `y_*` act on the rate of sideslip (1/s per rad or per rad/s), `l_*` on roll acceleration, `n_*` on yaw acceleration (1/s^2
    per rad, 1/s per rad/s); the suffix is what they multiply: sideslip, roll rate, yaw rate, aileron, rudder.
    """

    y_beta: float
    y_p: float
    y_r: float
    y_da: float
    y_dr: float
    l_beta: float
    l_p: float
    l_r: float
    l_da: float
    l_dr: float
    n_beta: float
    n_p: float
    n_r: float
    n_da: float
    n_dr: float


def aerosonde(airspeed_mps: float) -> LateralDerivatives:
    """Return the Aerosonde's lateral derivatives at an airspeed (m/s)."""
    gamma = _JX * _JZ - _JXZ**2
    g3, g4, g8 = _JZ / gamma, _JXZ / gamma, _JX / gamma
    force = 0.5 * _AIR_DENSITY * airspeed_mps * _WING_AREA_M2 / _MASS_KG
    moment = 0.5 * _AIR_DENSITY * airspeed_mps**2 * _WING_AREA_M2 * _SPAN_M
    per_rate = _SPAN_M / (2.0 * airspeed_mps)

    def roll(cl: float, cn: float) -> float:
        return moment * (g3 * cl + g4 * cn)

    def yaw(cl: float, cn: float) -> float:
        return moment * (g4 * cl + g8 * cn)

    return LateralDerivatives(
        y_beta=force * _CY_BETA,
        y_p=force * _CY_P * per_rate,
        y_r=force * _CY_R * per_rate - 1.0,
        y_da=force * _CY_DA,
        y_dr=force * _CY_DR,
        l_beta=roll(_CL_BETA, _CN_BETA),
        l_p=roll(_CL_P, _CN_P) * per_rate,
        l_r=roll(_CL_R, _CN_R) * per_rate,
        l_da=roll(_CL_DA, _CN_DA),
        l_dr=roll(_CL_DR, _CN_DR),
        n_beta=yaw(_CL_BETA, _CN_BETA),
        n_p=yaw(_CL_P, _CN_P) * per_rate,
        n_r=yaw(_CL_R, _CN_R) * per_rate,
        n_da=yaw(_CL_DA, _CN_DA),
        n_dr=yaw(_CL_DR, _CN_DR),
    )
