"""Searched vehicles: how the search of a denied vehicle begins, uses ranges and ends.

At its end the vehicle has states again.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, NoEstimateReason, RangeMeasurement, Unlocated
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import ManoeuvreDetector
from gcs_coloc.estimators.fleet.ekf.cluster import ClusterSet
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome
from gcs_coloc.estimators.fleet.ekf.possible_motion import HORIZONTAL, MotionProfile
from gcs_coloc.estimators.fleet.ekf.records import Neighbour
from gcs_coloc.estimators.fleet.ekf.state import POSITION, pair_key
from gcs_coloc.estimators.fleet.gaps import add_gap, tell_of_all_directions
from gcs_coloc.estimators.fleet.initialisation import begin_without_reports, block_from_estimate, initialise_from_reports
from gcs_coloc.estimators.fleet.search.multilateration import LEAST_PEERS
from gcs_coloc.estimators.fleet.search.position_search import PositionSearch, RangeCircle, is_too_wide
from gcs_coloc.estimators.fleet.search.range_fit import LEAST_RANGES
from gcs_coloc.estimators.fleet.settings import FleetSettings

_UNSHOWN_LOG_ODDS = -3.0
"""Chosen: one in twenty, so that a place where only a manoeuvre leads that the vehicle has not shown before stays possible."""


def is_searching(clusters: ClusterSet, vehicle: int, other: int, m: RangeMeasurement) -> bool:
    """Return whether a vehicle is searched; begin where it is too uncertain to linearise this range."""
    record, cluster = clusters.records[vehicle], clusters.get(vehicle)
    if cluster is None:
        return record.search is not None
    add_gap(cluster, vehicle, m.measured_at_s)
    P = cluster.joint.covariance(vehicle)
    if not is_too_wide(P.item(0, 0) + P.item(1, 1), m.range_m, m.sigma_m):
        return False
    there = _locate_peer(clusters, other, m)
    if there is None:
        return False
    # What a peer's own error adds to a range is no reason to search.
    sigma_m = math.sqrt(m.sigma_m**2 + float(np.trace(there[1])) / 3.0)
    _, P = cluster.predict(vehicle, m.measured_at_s)
    if not is_too_wide(P.item(0, 0) + P.item(1, 1), m.range_m, sigma_m):
        return False
    search_with(clusters, vehicle, search_of(clusters, vehicle, m.measured_at_s))
    return True


def begin_by_slow_ranges(clusters: ClusterSet, vehicle: int, other: int, m: RangeMeasurement) -> bool:
    """Begin the search of a vehicle without states by this range, if ranges are slow; return whether.

    They are if as many as a multilateration needs take longer than it allows. The search begins all around the other end.
    """
    record, s = clusters.records.writable(vehicle), clusters.settings
    last = record.range_measurements[-LEAST_RANGES:]
    peers = {each.other_end(vehicle) for each in last}
    if not len(record.recent_ranges) < LEAST_RANGES == len(last) or len(peers) < LEAST_PEERS:
        return False
    there = _locate_peer(clusters, other, m)
    if there is None:
        return False
    speeds_mps = 0.5 * record.profile.max_speed_mps, record.profile.max_climb_mps
    sigmas = np.repeat((m.range_m, *speeds_mps), (3, 2, 1))
    mean, covariance = block_from_estimate(np.concatenate([there[0], np.zeros(3)]), np.diag(sigmas**2), s)
    search = PositionSearch.of_state(mean, covariance, m.measured_at_s)
    height = next((each for each in reversed(record.recent_own) if isinstance(each, AltitudeMeasurement)), None)
    if height is not None:
        search = search.with_height(height.up_m, height.sigma_m**2)
    record.search = replace(search, agreed=0)
    begin_without_reports(record, m.measured_at_s, s)
    return True


def search_of(clusters: ClusterSet, vehicle: int, at_s: float) -> PositionSearch | None:
    """Return the search of a denied vehicle, or a new one that begins with its states.

    A new one also holds all that the vehicle may have done in a gap.
    """
    record, cluster = clusters.records[vehicle], clusters.get(vehicle)
    if cluster is None:
        return record.search
    x, P = cluster.predict(vehicle, at_s)
    search = PositionSearch.of_state(x, P, at_s)
    if record.unshown is None:
        return search
    P = P.copy()
    P[HORIZONTAL] += record.unshown.not_ruled_out().covariance(at_s)
    return search.joined([(PositionSearch.of_state(x, P, at_s), _UNSHOWN_LOG_ODDS)])


def search_with(clusters: ClusterSet, vehicle: int, search: PositionSearch | None) -> None:
    """Search a denied vehicle from now on: it leaves its cluster."""
    clusters.records.writable(vehicle).search = search
    clusters.remove(vehicle)


def search_with_range(clusters: ClusterSet, vehicle: int, other: int, m: RangeMeasurement) -> Outcome:
    """Update a search with a range; with one place left, initialise the vehicle's states there."""
    record, at_s = clusters.records[vehicle], m.measured_at_s
    assert record.search is not None
    there = _locate_peer(clusters, other, m)
    if there is None:
        return Outcome.KEPT_INITIALISING
    search = predicted_search(record.search, record.profile, at_s, clusters.settings)
    error = record.lasting_error((other, m.device_id))
    if error is not None:
        # An error of a range that lasts is as one of the peer's distance.
        there = there[0], there[1] + error.sigma_m**2 * np.eye(3)
    range_m = m.range_m if error is None else max(m.range_m - error.mean_m, 0.0)
    search = record.search = search.with_range(RangeCircle(other, *there, range_m, m.sigma_m**2))
    if search.is_lost:
        record.search, record.no_estimate_reason = None, Unlocated(NoEstimateReason.CONTRADICTORY)
        return Outcome.KEPT_INITIALISING
    record.neighbours[other] = Neighbour(at_s, (0.0, 0.0, 0.0), pair_key(vehicle, other, m.device_id), math.inf)
    place = search.narrow_place(m.range_m, math.sqrt(m.sigma_m**2 + float(np.trace(there[1])) / 3.0))
    if place is None:
        return Outcome.SEARCHING
    clusters.initialise(vehicle, *place, at_s)
    # The search gave `unshown` one in twenty alone, so it stays until ranges rule it out.
    record.search = record.attitude = record.tilt = None
    record.forget_tests()
    record.manoeuvre = ManoeuvreDetector()
    record.updated_at_s = record.gaps_added_until_s = at_s
    if tell_of_all_directions(record):
        record.told_at_s = at_s
    return Outcome.INITIALISED


def predicted_search(search: PositionSearch, profile: MotionProfile, at_s: float, settings: FleetSettings) -> PositionSearch:
    """Return a search at a later time, as its vehicle may move."""
    s = settings
    densities = s.low_speed_density_m2ps3, s.unobserved_climb_density_m2ps3
    return search.predicted(at_s, densities, (0.5 * profile.max_speed_mps, profile.max_climb_mps))


def _locate_peer(clusters: ClusterSet, vehicle: int, m: RangeMeasurement) -> tuple[FloatArray, FloatArray] | None:
    """Return position (3,) and covariance (3, 3) of a peer by its states, None where it has none.

    The position is that of the virtual end of a range.
    """
    record, at_s = clusters.records[vehicle], m.measured_at_s
    if vehicle not in clusters and (record.denied_vehicle or not initialise_from_reports(clusters, vehicle, at_s)):
        return None
    cluster = clusters[vehicle]
    if record.static:
        x, P = cluster.joint.mean(vehicle), cluster.joint.covariance(vehicle)
    else:
        x, P = cluster.predict(vehicle, at_s)
    e, n, u = x[POSITION].tolist()
    return np.array(m.virtual_end(vehicle, (e, n, u))), P[POSITION, POSITION].copy()
