"""Where a vehicle is with its uncertainty, as a polygon of latitudes and longitudes."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.snapshot import VehicleSnapshot

_CORNERS = 24
_SIGMAS = 2.0


def ellipse(vehicle: VehicleSnapshot) -> list[tuple[float, float]] | None:
    """The 2-sigma ellipse: 25 corners (latitude, longitude) in degrees, the last the first; None where there is no estimate.

    It holds the true position with 86 % if the covariance is right.
    """
    if vehicle.covariance_h_m2 is None or vehicle.lat_deg is None or vehicle.lon_deg is None or vehicle.alt_msl_m is None:
        return None
    ee, en, nn = vehicle.covariance_h_m2
    values, vectors = np.linalg.eigh(np.array([[ee, en], [en, nn]]))
    angles = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    circle = np.vstack([np.cos(angles), np.sin(angles)])
    corners = (_SIGMAS * vectors @ (np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * circle)).T
    frame = LocalFrame(vehicle.lat_deg, vehicle.lon_deg, vehicle.alt_msl_m)
    ring = [frame.geodetic_from_enu(float(e), float(n), 0.0)[:2] for e, n in corners]
    return [*ring, ring[0]]
