"""Evidence from ranges that a denied vehicle's state is wrong, or on the wrong side of its peers.

The refused ranges go into a CUSUM test. A gate that locks itself out is the worst failure of a filter: confident and lost. So the
refused ranges of a denied vehicle are evidence that its state is wrong, the used ones that it is right, eq. (21). Ranges to two
peers fit on both sides of the line through them: a vehicle on the wrong side finds these two fitting and refuses all others.
After a gap it may be on either side; the next ranges are linearised at the predicted position, so they confirm the side of the
prediction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.estimators.fleet.ambiguity.reflection import (
    CLEARLY_ASIDE_SIGMAS,
    COVERED_SIGMAS,
    ReflectionPlane,
    offset_sigmas,
    vertical_plane_through,
    vertical_plane_through_line,
)
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.ekf.process_model import ATTITUDE_HELD_S, NOTICED_INTERVAL_S, shows_its_motion
from gcs_coloc.estimators.fleet.ekf.records import (
    Neighbour,
    ReflectionEvidence,
    SuspectedDevice,
    UnresolvedOutlier,
    VehicleRecord,
)
from gcs_coloc.estimators.fleet.ekf.state import POSITION, pair_key
from gcs_coloc.estimators.fleet.ekf.update import missed_turn_covariance
from gcs_coloc.estimators.fleet.settings import FleetSettings

_CUSUM_REFUSED = 0.88
"""Log-likelihood ratio of a refused range: ln(0.8 / 0.33), four of five are refused in a wrong state, one of three at most
in a right one."""
_CUSUM_USED = -1.2  # log-likelihood ratio of a used range: ln(0.2 / 0.67)
_CUSUM_LIMIT = 7.0  # chosen: eight refused ranges in a row; fewer inflate on multipath, more let a wrong state stand longer
_REFUSED_MEMORY = 0.7
"""Chosen: share of the mean squared innovation that the next refused range keeps: the mean of the last three."""
_INFLATION_KEPT = 0.8
"""Chosen: each used range takes a fifth of the noise inflation away: half is gone after three ranges that agree."""
_SUSPICION_KEPT = 0.2
"""Chosen: share of the suspicion that a range within one sigma leaves. One of a faulty device, anywhere within the gate of four
sigmas, is so by chance, one time in four."""
_TRUSTED_SHARE = 0.1  # chosen: a device is suspected no more once that adds a tenth to the variance of its ranges
_LEAST_INFORMATION = 1e-6  # keeps the determinant of the direction matrix positive with one neighbour
_ENOUGH_RANGES = 2  # chosen: two refused ranges in a row that fit the reflected position open a hypothesis; one may be multipath
_SMALLER_SHARE = 0.9  # chosen: the ranges after a gap count as informative where they reduced the sigma by a tenth
_EITHER_SIDE_SIGMAS = 4.0  # chosen: as the gate; a plane within so many sigmas of the saved estimate leaves both sides possible


def monitor_range(cluster: Cluster, vehicle: int, other: int, result: UpdateResult, m: RangeMeasurement) -> None:
    """Record the result of a range to `other`; inflate the covariance if the CUSUM test fails."""
    record = cluster.records[vehicle]
    if result.degrees_of_freedom > 0:
        record.reflection_evidence = update_reflection_evidence(record.reflection_evidence, cluster, vehicle, other, result, m)
    if result.used:
        pair = pair_key(vehicle, other, m.device_id)
        last = record.neighbours.get(other)
        interval_s = 0.0 if last is None else last.interval_until_s(m.measured_at_s)
        record.neighbours[other] = Neighbour(m.measured_at_s, result.unit, pair, result.sigma_m, interval_s)
        record.updated_at_s = m.measured_at_s
        outlier = record.unresolved_outlier
        if outlier is None or outlier.neighbour == other or _is_resolved(record, outlier, m.measured_at_s, cluster.settings):
            record.cusum = max(record.cusum + _CUSUM_USED, 0.0)
            record.unresolved_outlier = None
        record.range_noise_inflation_m2 *= _INFLATION_KEPT
        if result.nis <= 1.0:
            _trust_more(record, other, result.sigma_m)
        return
    if result.degrees_of_freedom == 0:
        return
    square, kept = result.innovation_m**2, _REFUSED_MEMORY if record.cusum > 0.0 else 0.0
    record.refused_innovation_m2 = kept * record.refused_innovation_m2 + (1.0 - kept) * square
    record.cusum += _CUSUM_REFUSED
    refused = _outlier(other, result)
    if _is_resolved(record, refused, m.measured_at_s, cluster.settings):
        record.unresolved_outlier = None
        # Within the gate it is off by so much at most, however far the refused ones were.
        _suspect(record, other, (cluster.settings.gate_sigma * result.sigma_m) ** 2)
    else:
        record.unresolved_outlier = refused
        record.suspected.pop(other, None)
    if record.cusum > _CUSUM_LIMIT:
        # The first ranges after the inflation may be the wrong ones: their noise is inflated too, until some have agreed.
        cluster.inflate_covariance(vehicle, record.refused_innovation_m2)
        record.range_noise_inflation_m2 = record.refused_innovation_m2
        record.cusum = 0.0
        record.unresolved_outlier = None
        record.suspected = {}


def _suspect(record: VehicleRecord, other: int, variance_m2: float) -> None:
    """Suspect a neighbour's device by one more refused range; its next one has `variance_m2` more."""
    before = record.suspected.get(other)
    record.suspected[other] = SuspectedDevice(1 if before is None else before.refused + 1, variance_m2)


def _trust_more(record: VehicleRecord, other: int, sigma_m: float) -> None:
    """Trust a neighbour's device more by a range that fits, with the sigma of its innovation."""
    left_m2 = _SUSPICION_KEPT * record.suspicion_m2(other)
    suspected = record.suspected.pop(other, None)
    if suspected is not None and left_m2 > _TRUSTED_SHARE * sigma_m**2:
        record.suspected[other] = suspected._replace(variance_m2=left_m2)


def add_missed_turn(cluster: Cluster, vehicle: int, other: int, refused: UpdateResult, m: RangeMeasurement) -> bool:
    """Add a turn, eq. (20), where the ranges of two neighbours tell of one; return whether.

    A denied vehicle without fresh attitude turns unseen where ranges come seldom. One refused range may be off itself; with one
    of another neighbour just before, and none in use that is young enough to contradict both, the way is wrong.
    """
    record, s, at_s = cluster.records[vehicle], cluster.settings, m.measured_at_s
    last, before = record.neighbours.get(other), record.unresolved_outlier
    if last is None or at_s - last.at_s <= NOTICED_INTERVAL_S or shows_its_motion(record, s, at_s):
        return False
    if before is None or before.neighbour == other or _is_resolved(record, _outlier(other, refused), at_s, s):
        return False
    # The turn may have begun as long before the last range that fitted.
    since_s, most_mps2 = min(2.0 * (at_s - last.at_s), ATTITUDE_HELD_S), record.profile.max_acceleration_mps2
    if abs(refused.innovation_m) > record.profile.reach_m(since_s, most_mps2) + s.gate_sigma * refused.sigma_m:
        return False
    cluster.joint.covariance(vehicle)[:6, :6] += missed_turn_covariance(since_s, most_mps2)
    return True


def _outlier(neighbour: int, refused: UpdateResult) -> UnresolvedOutlier:
    return UnresolvedOutlier(neighbour, refused.unit, refused.innovation_m, refused.nis)


def unresolved_outlier_variance_m2(record: VehicleRecord) -> float:
    """Return the variance, m^2, to add to an estimate while a refused range is unresolved.

    Unresolved means that either the state or the range may be wrong. It counts from the second refused range in a row on: a
    single one is an outlier.
    """
    if record.unresolved_outlier is None or record.cusum < 2.0 * _CUSUM_REFUSED:
        return 0.0
    return record.refused_innovation_m2 / COVERED_SIGMAS**2


def _is_resolved(record: VehicleRecord, refused: UnresolvedOutlier, at_s: float, s: FleetSettings) -> bool:
    """Whether the ranges in use would show the displacement that a refused range suggests, eq. (22).

    Of all horizontal displacements that explain the refused range, the least visible one moves the other ranges by the
    innovation times the root of 1 / (u' N^-1 u); N is the sum of their u u', u a unit vector along the range. With one other
    peer that is nothing. A range shows nothing of a displacement that the vehicle may have made since it was used.
    """
    profile, displacement_m = record.profile, abs(refused.innovation_m)
    ee = nn = _LEAST_INFORMATION
    en = 0.0
    for vehicle, neighbour in record.neighbours.items():
        since_s = at_s - neighbour.at_s
        # The turn may have begun as long again before: what it had done by then was within the gate.
        may_be_new = profile.reach_m(2.0 * since_s, profile.max_acceleration_mps2) >= displacement_m
        if vehicle != refused.neighbour and not may_be_new and since_s <= neighbour.in_use_s:
            e, n, _ = neighbour.unit
            ee, en, nn = ee + e * e, en + e * n, nn + n * n
    e, n, _ = refused.unit
    least = e * e * nn - 2.0 * e * n * en + n * n * ee
    return refused.nis * (ee * nn - en * en) > s.gate_sigma**2 * least


class SavedEstimate(NamedTuple):
    """The horizontal estimate of a denied vehicle before a range.

    It holds the mean in m and the covariance in m^2. `sigma_m` is the sigma along the major axis.
    """

    east_m: float
    north_m: float
    ee_m2: float
    en_m2: float
    nn_m2: float
    sigma_m: float


def save_estimate(cluster: Cluster, denied_vehicle: int, at_s: float | None = None) -> SavedEstimate:
    """Return the horizontal estimate of a denied vehicle at a time, by default that of its states."""
    joint = cluster.joint
    x, P = (
        (joint.mean(denied_vehicle), joint.covariance(denied_vehicle)) if at_s is None else cluster.predict(denied_vehicle, at_s)
    )
    return SavedEstimate(x.item(0), x.item(1), P.item(0, 0), P.item(0, 1), P.item(1, 1), horizontal_sigma_m(P))


def plane_after_gap(before: SavedEstimate, cluster: Cluster, denied_vehicle: int, at_s: float) -> ReflectionPlane | None:
    """Return the plane through the peers if only ranges after a gap decided the side, else None."""
    if horizontal_sigma_m(cluster.joint.covariance(denied_vehicle)) > _SMALLER_SHARE * before.sigma_m:
        return None
    plane = vertical_plane_through_line(cluster, denied_vehicle, at_s)
    if plane is None or abs(offset_sigmas(cluster, denied_vehicle, plane, at_s)) < CLEARLY_ASIDE_SIGMAS:
        return None
    (e, n, _), (at_e, at_n, _) = plane.normal.tolist(), plane.point_m.tolist()
    offset_m = (before.east_m - at_e) * e + (before.north_m - at_n) * n
    variance_m2 = e * e * before.ee_m2 + 2.0 * e * n * before.en_m2 + n * n * before.nn_m2
    return plane if abs(offset_m) < _EITHER_SIDE_SIGMAS * math.sqrt(max(variance_m2, 0.0)) else None


def update_reflection_evidence(
    before: ReflectionEvidence | None,
    cluster: Cluster,
    denied_vehicle: int,
    other: int,
    result: UpdateResult,
    m: RangeMeasurement,
) -> ReflectionEvidence | None:
    """Return the evidence for the reflected state of a denied vehicle after one more range.

    `other` is the vehicle at the other end of that range. None means that there is no evidence.
    """
    if not result.used:
        peers = _other_peers(cluster, denied_vehicle, other, m.measured_at_s)
        if _fits_reflection(cluster, denied_vehicle, other, peers, result, m):
            # Those that fit on the other side of other peers are evidence for another state.
            return ReflectionEvidence(other, peers, before.ranges + 1 if before is not None and before.peers == peers else 1)
    return None if before is not None and before.neighbour == other else before


def plane_of_refused_ranges(
    evidence: ReflectionEvidence | None, cluster: Cluster, denied_vehicle: int, at_s: float
) -> ReflectionPlane | None:
    """Return the plane on whose other side refused ranges place a vehicle; None if too few, or no plane."""
    if evidence is None or evidence.ranges < _ENOUGH_RANGES:
        return None
    if _other_peers(cluster, denied_vehicle, evidence.neighbour, at_s) != evidence.peers:
        return None
    return vertical_plane_through(cluster, denied_vehicle, sorted(evidence.peers), at_s)


def _other_peers(cluster: Cluster, denied_vehicle: int, neighbour: int, at_s: float) -> frozenset[int]:
    """Return the peers in use other than one neighbour."""
    return frozenset(cluster.peers_in_use(denied_vehicle, at_s)) - {neighbour}


def _fits_reflection(
    cluster: Cluster, denied_vehicle: int, other: int, peers: frozenset[int], result: UpdateResult, m: RangeMeasurement
) -> bool:
    """Return whether a range with `other` fits on the other side of the plane through two `peers`."""
    plane = vertical_plane_through(cluster, denied_vehicle, sorted(peers), m.measured_at_s) if len(peers) == 2 else None
    if plane is None:
        return False
    position, n = np.array(cluster.position(denied_vehicle)), plane.normal
    reflected = position - 2.0 * float((position - plane.point_m) @ n) * n
    residual_m = m.range_m - math.dist(reflected, m.virtual_end(other, cluster.position(other)))
    variance_m2 = result.sigma_m**2 + float(np.trace(cluster.joint.covariance(denied_vehicle)[POSITION, POSITION]))
    return residual_m * residual_m <= cluster.settings.gate_sigma**2 * variance_m2
