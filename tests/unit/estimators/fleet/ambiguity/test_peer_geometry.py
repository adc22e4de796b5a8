from __future__ import annotations

import numpy as np
import pytest

from gcs_coloc.core.measurements import AltitudeMeasurement
from gcs_coloc.estimators.fleet.ambiguity.peer_geometry import PeerGeometry
from gcs_coloc.estimators.fleet.ekf.cluster import ClusterSet
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.initialisation import block_from_estimate
from gcs_coloc.estimators.fleet.settings import FleetSettings


def test_the_sigma_of_the_newest_height_counts():
    """It was that of the oldest within two seconds: a barometer that had just become worse told of the side as before."""
    settings, record = FleetSettings(), VehicleRecord(denied_vehicle=True)
    for t, sigma_m in ((0.0, 1.0), (0.5, 4.0)):
        record.add_own(AltitudeMeasurement(4, t, t, 100.0, sigma_m))
    clusters = ClusterSet(settings, {4: record, 5: VehicleRecord()})
    for vehicle, place in ((4, (0.0, 0.0, 100.0)), (5, (300.0, 0.0, 100.0))):
        clusters.initialise(vehicle, *block_from_estimate(np.array([*place, 0.0, 0.0, 0.0]), np.eye(6), settings), 0.5)
    view = PeerGeometry(clusters.merge(4, 5), 4, [5], 0.5)
    assert view.altitude_separation(1.0, 10.0) == pytest.approx((20.0 / 4.0) ** 2)
