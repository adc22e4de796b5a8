"""Which ranges of a denied vehicle show their lasting errors, and what is known of the lasting error of one pair."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import POSITION
from gcs_coloc.estimators.fleet.range_biases import BiasSample, BiasWindow, PairBias, Ranged

_HEIGHT_FRESH_S = 1.5
"""Chosen: heights at 1 Hz, one of which may be late."""


def observe_bias(cluster: Cluster, vehicle: int, other: int, m: RangeMeasurement, white_m: float, coloured_m: float) -> None:
    """Add a range that was used to the window of a denied vehicle; a window that is over tells of the lasting errors."""
    record, at_s = cluster.records[vehicle], m.measured_at_s
    window = record.bias_window
    if window is not None and at_s > window.is_over_at_s:
        peers_m2: dict[Ranged, FloatArray] = {}
        for sample in window.samples:
            peer = sample.peer[0]
            if peer in cluster.joint.where:
                peers_m2[sample.peer] = cluster.joint.covariance(peer)[POSITION, POSITION]
        if len(peers_m2) == len({sample.peer for sample in window.samples}):
            record.range_biases = record.range_biases.with_window(window, peers_m2, cluster.settings.range_bias_sigma_m)
        window = None
    if window is None:
        x, P = cluster.joint.mean(vehicle)[:6].copy(), cluster.joint.covariance(vehicle)[:6, :6].copy()
        x[POSITION] = cluster.position(vehicle)
        height = _newest_height(record, at_s)
        height_m2 = None
        if height is not None:
            # The height of the state goes with the biases already; the measured one does not.
            x[2], P[2, 2], height_m2 = height.up_m, height.sigma_m**2, height.sigma_m**2
        window = BiasWindow(at_s, x, P, height_m2, record.profile.max_acceleration_mps2)
    place = cluster.position(other)
    record.bias_window = window.with_sample(BiasSample(at_s, (other, m.device_id), m.range_m, white_m, coloured_m, place))


def _newest_height(record: VehicleRecord, at_s: float) -> AltitudeMeasurement | None:
    """Return the newest height of a vehicle, None where it is not fresh."""
    heights = (m for m in reversed(record.recent_own) if isinstance(m, AltitudeMeasurement))
    newest = next(heights, None)
    return newest if newest is not None and at_s - newest.measured_at_s <= _HEIGHT_FRESH_S else None


def pair_bias(denied: Sequence[tuple[int, int, VehicleRecord]], m: RangeMeasurement) -> PairBias | None:
    """Return what is known of the lasting error of a range; None while nothing shows one.

    `denied` holds the denied ends as (vehicle, other end, record). Two denied vehicles have not been told apart from their peers:
    with devices that are alike their range errs as those to the peers do, which is known to half of it.
    """
    if len(denied) == 1:
        return denied[0][2].range_biases.bias((denied[0][1], m.device_id))
    known = [bias for _, _, record in denied if (bias := record.range_biases.bias(None)) is not None]
    if not known:
        return None
    mean_m = sum(bias.mean_m for bias in known) / len(known)
    return PairBias(mean_m, math.hypot(0.5 * mean_m, *(bias.sigma_m for bias in known)))
