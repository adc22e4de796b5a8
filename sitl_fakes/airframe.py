"""The aircraft's lateral aerodynamics: the Aerosonde's published coefficients made dimensional at one airspeed.

Source: R. W. Beard and T. W. McLain, "Small Unmanned Aircraft: Theory and Practice", Princeton University Press, 2012:
inertia products Gamma of Eq. (3.13), lateral moment coefficients of Eqs. (5.23)-(5.24) ff., linear lateral model of
Section 5.5.1 and Table 5.1; Aerosonde parameters of Appendix E, Table E.2, with the values of the book's later printings
(the authors' uavbook supplement), which differ from the first printing's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GRAVITY_MPS2 = 9.80665

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


@dataclass(frozen=True, slots=True)
class LateralDerivatives:
    """Dimensional lateral derivatives at one airspeed, level flight, pitch angle zero (stability axes).

    `y_*` act on the rate of sideslip (1/s per rad or per rad/s), `l_*` on roll acceleration, `n_*` on yaw acceleration (1/s^2
    per rad, 1/s per rad/s); the suffix is what they multiply: sideslip, roll rate, yaw rate, aileron, rudder.
    """

    airspeed_mps: float
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
        airspeed_mps=airspeed_mps,
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


def state_matrix(d: LateralDerivatives) -> NDArray[np.float64]:
    """System matrix (5, 5) of the linear lateral model, states [beta, p, r, phi, psi] in rad and rad/s (Beard & McLain 5.5.1)."""
    return np.array(
        [
            [d.y_beta, d.y_p, d.y_r, GRAVITY_MPS2 / d.airspeed_mps, 0.0],
            [d.l_beta, d.l_p, d.l_r, 0.0, 0.0],
            [d.n_beta, d.n_p, d.n_r, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0, 0.0],
        ]
    )


def input_matrix(d: LateralDerivatives) -> NDArray[np.float64]:
    """Input matrix (5, 2) of the linear lateral model, inputs [aileron, rudder] in rad."""
    return np.array([[d.y_da, d.y_dr], [d.l_da, d.l_dr], [d.n_da, d.n_dr], [0.0, 0.0], [0.0, 0.0]])
