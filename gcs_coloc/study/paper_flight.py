"""The paper's flight: the four routes of Table 1, flown by the simulated aircraft without noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.study.paper_options import PaperOptions
from sitl_fakes.guidance import EndOfRoute
from sitl_fakes.nominal import PAPER_ROUTES, fly_routes


@dataclass(frozen=True, slots=True)
class PaperFlight:
    """True motion: times (T,) s, positions (4, T, 2) m and velocities (4, T, 2) m/s of UAV1-4, and their routes' waypoints."""

    times_s: FloatArray
    positions_m: FloatArray
    velocities_mps: FloatArray
    routes_m: tuple[FloatArray, ...]


def fly(options: PaperOptions) -> PaperFlight:
    """Fly Table 1 under the options; sample k is at k steps."""
    nominal = fly_routes(
        airspeed_mps=options.speed_mps,
        step_s=options.step_s,
        duration_s=options.duration_s,
        end_of_route=EndOfRoute(options.end_of_route),
    )
    return PaperFlight(
        times_s=nominal.times_s,
        positions_m=np.stack([nominal.east_m, nominal.north_m], axis=-1),
        velocities_mps=np.stack([nominal.ve_mps, nominal.vn_mps], axis=-1),
        routes_m=tuple(np.array(route) for route in PAPER_ROUTES),
    )
