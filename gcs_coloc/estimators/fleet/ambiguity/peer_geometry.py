"""Geometry of a denied vehicle and its peers, with covariances only where a test needs them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius, major_axis_rad
from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, Vector3
from gcs_coloc.estimators.fleet.ambiguity.curved_ranges import curvature_covariances
from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.process_model import fresh_air_data
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S
from gcs_coloc.estimators.fleet.ekf.state import POSITION, TIME_STAMP_OFFSET, VELOCITY

NEAR_SIGMAS = 4.0
"""Chosen: as the gate; a vehicle within so many sigmas of a plane may be on either side of it."""
SEPARATED = 2.0
"""Chosen: squared normalised difference of the measurements between the two sides from which on they decide by themselves."""
LEAST_SIGMA_M = 1e-3
"""Bounds variances away from zero."""
_LEAST_DISTANCE_M = 1.0  # bounds the distances that slopes are divided by


class PeerGeometry:
    """Positions of a denied vehicle and its peers at one time, with bounds on their uncertainty.

    The bounds cost little to compute. `offset` is the vehicle's position relative to the mean `centre` of its peers, `offsets`
    theirs, `distance_m` its distances. `largest_sigma_m` bounds the sigma of the vector between the vehicle and any peer in any
    direction.
    """

    def __init__(self, cluster: Cluster, denied_vehicle: int, peers: list[int], at_s: float) -> None:
        self.cluster = cluster
        self.own = cluster.range_end(denied_vehicle)
        self.peers = [cluster.range_end(v) for v in peers]
        positions = [peer.position for peer in self.peers]
        ce, cn, cu = self.centre = [math.fsum(axis) / len(peers) for axis in zip(*positions, strict=True)]
        self.offsets: list[Vector3] = [(e - ce, n - cn, u - cu) for e, n, u in positions]
        e, n, u = self.own.position
        self.offset = (e - ce, n - cn, u - cu)
        self.distance_m = [max(math.dist(self.own.position, position), _LEAST_DISTANCE_M) for position in positions]
        self.nearest_m = min(self.distance_m)
        covariance = cluster.joint.covariance(denied_vehicle)[POSITION, POSITION]
        curved = curvature_covariances(cluster, denied_vehicle, covariance, at_s)
        self._curved_m2 = None if curved is None else curved[0]
        curved_m2 = 0.0 if curved is None else float(np.trace(curved[0]))
        largest_sigma_m = (
            math.sqrt(curved_m2)
            + _largest_sigma_m(cluster, self.own)
            + max(_largest_sigma_m(cluster, peer) for peer in self.peers)
        )
        record = cluster.records[denied_vehicle]
        presumed = record.presumed_bias if record.unknown_bias is not None else None
        self._lasting_m2 = 0.0 if presumed is None else presumed.pair_m**2
        largest_m2 = largest_sigma_m**2 + SEPARATED * self._lasting_m2
        self.largest_sigma_m = max(math.sqrt(largest_m2) if presumed is not None else largest_sigma_m, LEAST_SIGMA_M)
        self.has_air_data = fresh_air_data(record, cluster.settings, at_s) is not None
        self._altitude_sigma_m = math.inf
        for m in reversed(record.own_measurements):
            if at_s - m.measured_at_s > IN_USE_S:
                break
            if isinstance(m, AltitudeMeasurement):
                self._altitude_sigma_m = m.sigma_m
                break

    def least_range_sigmas_m(self) -> Iterator[float]:
        """Yield lower bounds of the largest range sigma, m: a constant, then that of the distance to a peer."""
        yield LEAST_SIGMA_M
        yield math.sqrt(max(float(self.difference_covariance(0)[0, 0]), 0.0))

    def difference_covariance(self, i: int) -> FloatArray:
        """Return the covariance (4, 4), m^2, from peer i to the vehicle: along their line, east, north, up."""
        (e, n, u), (pe, pn, pu), distance_m = self.offset, self.offsets[i], self.distance_m[i]
        unit = ((e - pe) / distance_m, (n - pn) / distance_m, (u - pu) / distance_m)
        covariance = self.cluster.joint.predict_measurement(self.cluster.range_jacobian(self.own, self.peers[i], unit))[1]
        covariance[0, 0] += self._lasting_m2
        return covariance

    def seen_from(self, normal: FloatArray) -> tuple[FloatArray, float, float]:
        """Return what is known of the vectors to the peers across a plane with the unit normal (3,).

        The variances (k,) of the distances, m^2, the largest variance along the normal, m^2, and `blind_m` for the former.
        """
        covariances = [self.difference_covariance(i) for i in range(len(self.peers))]
        variances_m2 = np.array([max(float(covariance[0, 0]), LEAST_SIGMA_M**2) for covariance in covariances])
        across_m2 = max(float(normal @ covariance[1:, 1:] @ normal) for covariance in covariances)
        if self._curved_m2 is not None:
            across_m2 += float(normal[:2] @ self._curved_m2 @ normal[:2])
        return variances_m2, across_m2, self.blind_m(math.sqrt(float(variances_m2.max())))

    def blind_m(self, range_sigma_m: float) -> float:
        """Return the distance from a plane within which the ranges change by less than their sigma, m."""
        return math.sqrt(2.0 * range_sigma_m * self.nearest_m)

    def line(self) -> tuple[tuple[float, float], float]:
        """Return the horizontal direction in which the peers spread most, and how far they do.

        The direction is a unit vector (east, north). The spread is the sum of squares along it, m^2.
        """
        ee = en = nn = 0.0
        for e, n, _ in self.offsets:
            ee += e * e
            en += e * n
            nn += n * n
        mean, radius = eigenvalue_mean_and_radius(ee, en, nn, math.hypot)
        course = major_axis_rad(ee, en, nn)
        return (math.cos(course), math.sin(course)), mean + radius

    def range_separation(self, normal: FloatArray, offset_m: float, range_variances_m2: FloatArray) -> float:
        """Return the squared normalised difference of the ranges between both sides of a plane.

        It holds for a vehicle at the distance `offset_m` from the plane. `normal` (3,) is its unit normal, `range_variances_m2`
        (k,) are the variances of the distances to the peers.
        """
        separation = 2.0 * offset_m * (np.array(self.offsets) @ normal) / np.array(self.distance_m)
        # A lasting error is one piece of evidence however many ranges there are, so it has to be two sigmas by itself.
        return float(np.sum(separation * separation / (range_variances_m2 + SEPARATED * self._lasting_m2)))

    def altitude_separation(self, upwards: float, offset_m: float) -> float:
        """Return the squared normalised difference of the vehicle's own height between both sides of a plane.

        `upwards` is the vertical component of its unit normal.
        """
        return (2.0 * offset_m * upwards / self._altitude_sigma_m) ** 2

    def has_second_place(self, normal: FloatArray, within: FloatArray, variance_m2: float) -> bool:
        """Return whether ranges that separate the sides of a plane may nearly fit a second place.

        A filter may stay at such a place. `normal` (3,) is the plane's unit normal, `variance_m2` that of the vehicle along it,
        `within` (3, m) the axes in the plane along which the vehicle is free. Off the plane by x, the range to a peer that is off
        it by y is longer by x^2 / 2d - x y / d. With the even and the odd coefficients e and o, the sum of squares for a vehicle
        at z is (x - z)^2 |(x + z) e + o|^2. What of o is along e moves the plane; with the rest of it, o', there is a second
        minimum where z^2 |e|^2 > 2 |o'|^2, eq. (40). A vehicle may be four sigmas off.
        """
        offsets, distances_m = np.array(self.offsets), np.array(self.distance_m)
        free, _ = np.linalg.qr((np.array(self.offset) - offsets) @ within / distances_m[:, np.newaxis])
        even, odd = (part - free @ (free.T @ part) for part in (0.5 / distances_m, offsets @ normal / distances_m))
        ee, eo, oo = float(even @ even), float(even @ odd), float(odd @ odd)
        return 2.0 * (ee * oo - eo * eo) < NEAR_SIGMAS**2 * variance_m2 * ee * ee

    def may_be_ambiguous(self, normal: FloatArray, within: FloatArray) -> bool:
        """Return whether it may be ambiguous on which side of a plane the vehicle is.

        The plane goes through the centre of the peers. Its side may be ambiguous where the vehicle is near the plane and the
        ranges do not separate the sides, or nearly fit a second place. The bounds used hold for any covariances.
        """
        ne, nn, nu = normal.tolist()
        offset_m = self.offset[0] * ne + self.offset[1] * nn + self.offset[2] * nu
        blind_m = self.blind_m(self.largest_sigma_m)
        if abs(offset_m) > max(NEAR_SIGMAS * self.largest_sigma_m, blind_m):
            return False
        slopes = ((e * ne + n * nn + u * nu) / d for (e, n, u), d in zip(self.offsets, self.distance_m, strict=True))
        # The ratio of the blind stretch to the range sigma only falls as the sigma grows.
        separation = 2.0 * blind_m / self.largest_sigma_m
        if separation * separation * sum(slope * slope for slope in slopes) <= SEPARATED:
            return True
        return self.has_second_place(normal, within, self.largest_sigma_m**2)


def _largest_sigma_m(cluster: Cluster, end: RangeEnd) -> float:
    """Return an upper bound on a position's sigma in any direction, m, with all errors fully correlated."""
    A, p = cluster.joint.A, end.where.start
    position_sigma_m = math.sqrt(A.item(p, p) + A.item(p + 1, p + 1) + A.item(p + 2, p + 2))
    if end.time_stamp_offset_s is None:
        return position_sigma_m
    v, s = p + VELOCITY.start, p + TIME_STAMP_OFFSET
    speed_sigma_mps = math.sqrt(A.item(v, v) + A.item(v + 1, v + 1) + A.item(v + 2, v + 2))
    return position_sigma_m + abs(end.time_stamp_offset_s) * speed_sigma_mps + math.hypot(*end.velocity) * math.sqrt(A.item(s, s))
