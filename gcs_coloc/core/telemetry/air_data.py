"""Air data: from the airspeed that is told to the one with which an aircraft moves through the air."""

from __future__ import annotations

from math import exp, sqrt

LEAST_AIRSPEED_MPS = 5.0
"""Below it an airspeed sensor and a coordinated turn mean nothing."""

_SEA_LEVEL_K = 288.15
_LAPSE_K_PER_M = 0.0065
_DENSITY_EXPONENT = 4.2559
_TROPOPAUSE_M = 11_000.0
_SCALE_HEIGHT_M = 6341.6  # of the isothermal layer above
_TOP_M = 20_000.0


def true_airspeed_mps(equivalent_mps: float, alt_msl_m: float) -> float:
    """True airspeed (m/s) from the equivalent one (m/s) at an altitude above mean sea level (m).

    VFR_HUD tells the calibrated or indicated airspeed, as MAVLink defines it. At the speeds of these aircraft both are the
    equivalent one; it is less than the true one by the root of the air's density, 5 % for each 1000 m.

    Source: density of the International Standard Atmosphere (ISO 2533) up to 20 km, beyond which it is taken as there. A day
    20 K warmer than standard leaves 3.5 %.
    """
    height_m = min(alt_msl_m, _TOP_M)
    density = (1.0 - _LAPSE_K_PER_M * min(height_m, _TROPOPAUSE_M) / _SEA_LEVEL_K) ** _DENSITY_EXPONENT
    density *= exp(-max(height_m - _TROPOPAUSE_M, 0.0) / _SCALE_HEIGHT_M)
    return equivalent_mps / sqrt(density)
