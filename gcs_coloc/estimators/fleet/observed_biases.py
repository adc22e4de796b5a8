"""Observed biases: ranges that show lasting errors, and what is known of the error of one pair."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import POSITION, VELOCITY, PairKey, UnknownKey
from gcs_coloc.estimators.fleet.range_biases import BiasSample, BiasWindow, PairBias, Ranged, UnknownBias
from gcs_coloc.estimators.fleet.settings import FleetSettings

_MOST_OF_A_DEVICE = 2.0
_MOST_OF_A_PAIR = 0.7
"""Chosen: the most that unknown biases are of a stated sigma: 0.7 to 2.8 and 0.4 to 1.4 in the sets behind the settings."""
_TELLING_SIGMAS = 4.0  # chosen: a bias below a quarter of the noise is below what else lasts: the errors of the peers' receivers
_HEIGHT_FRESH_S = 1.5  # chosen: heights at 1 Hz, one of which may be late


def observe_bias(cluster: Cluster, vehicle: int, other: int, m: RangeMeasurement, white_m: float, coloured_m: float) -> None:
    """Add a range that was used to the window of a denied vehicle.

    If that window is over, what it tells of the lasting errors goes to the record, and a new one begins.
    """
    record, at_s = cluster.records[vehicle], m.measured_at_s
    window = record.bias_window
    if window is not None and at_s > window.is_over_at_s:
        peers_m2: dict[Ranged, FloatArray] = {}
        for sample in window.samples:
            peer = sample.peer[0]
            if peer in cluster.joint.where:
                peers_m2[sample.peer] = cluster.joint.covariance(peer)[POSITION, POSITION]
        if len(peers_m2) == len({sample.peer for sample in window.samples}):
            least_m = cluster.settings.range_bias_sigma_m
            biases = record.range_biases.with_window(window, peers_m2, least_m, record.presumed_bias)
            record.range_biases = biases
            if biases.unknown is not None:
                record.unknown_bias = biases.unknown
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
    place = m.virtual_end(other, cluster.position(other))
    record.bias_window = window.with_sample(BiasSample(at_s, (other, m.device_id), m.range_m, white_m, coloured_m, place))


def _newest_height(record: VehicleRecord, at_s: float) -> AltitudeMeasurement | None:
    """Return the newest height of a vehicle, None where it is not fresh."""
    heights = (m for m in reversed(record.recent_own) if isinstance(m, AltitudeMeasurement))
    newest = next(heights, None)
    return newest if newest is not None and at_s - newest.measured_at_s <= _HEIGHT_FRESH_S else None


def presume_bias(record: VehicleRecord, sigma_m: float, s: FleetSettings) -> None:
    """Presume biases that nothing has shown.

    They count at once where ranges are so precise that these matter, else once they are seen to be larger. `sigma_m` is the
    stated sigma of a single range.
    """
    if record.unknown_bias is not None or s.unknown_device_bias_m <= 0.0:
        return
    telling = sigma_m < _TELLING_SIGMAS * s.unknown_device_bias_m
    if telling or record.presumed_bias is None:
        device_m, pair_m = min(s.unknown_device_bias_m, _MOST_OF_A_DEVICE * sigma_m), _MOST_OF_A_PAIR * sigma_m
        telling_m = 0.0 if telling else sigma_m
        record.presumed_bias = UnknownBias(device_m, min(s.unknown_pair_bias_m, pair_m), telling_m)
    if telling:
        record.unknown_bias = record.presumed_bias


def unknown_errors(denied: Sequence[tuple[int, int, VehicleRecord]], pair: PairKey) -> list[tuple[UnknownKey, float]]:
    """Return a range's unknown biases, each with its share: half of each end between two denied ones."""
    share = 1.0 / len(denied)
    return [
        (key, share)
        for vehicle, _, record in denied
        if record.unknown_bias is not None
        for key in (UnknownKey(vehicle, vehicle, vehicle), UnknownKey(*pair[:2], vehicle))
    ]


def unknown_bias_covariance(cluster: Cluster, vehicle: int, step_s: float) -> FloatArray:
    """Return the covariance (6, 6) that unknown biases add `step_s` after the states' time, eq. (38)."""
    joint, places, sigmas_m = cluster.joint, [], []
    for key, place in joint.where.items():
        if isinstance(key, UnknownKey):
            record = cluster.records[key.denied_vehicle]
            if record.unknown_bias is not None and record.range_biases.found is None:
                places.append(place.start)
                sigmas_m.append(record.unknown_bias.device_m if key.is_of_device else record.unknown_bias.pair_m)
    start = joint.where[vehicle].start
    moved = joint.A[start : start + VELOCITY.stop, places] * np.array(sigmas_m)
    moved[POSITION] += step_s * moved[VELOCITY]
    covariance: FloatArray = moved @ moved.T
    return covariance


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
