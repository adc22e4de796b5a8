"""Clusters of vehicles whose errors are correlated, and the set of all clusters.

A cluster propagates its joint state and inflates its covariance. Vehicles are correlated when they range each other or share
neighbours. A cluster begins with one vehicle, is merged by the first range with another, and is marginalised when no range links
its vehicles. `update` corrects its joint state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Integral

from gcs_coloc.core.measurements import FloatArray, RangeMeasurement, Vector3
from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd, Transition, range_jacobian
from gcs_coloc.estimators.fleet.ekf.air_data import steady_air_m2
from gcs_coloc.estimators.fleet.ekf.process_model import fresh_air_data, set_transition, step_ends
from gcs_coloc.estimators.fleet.ekf.records import Records
from gcs_coloc.estimators.fleet.ekf.state import HEADING_ERROR, TIME_STAMP_OFFSET, VELOCITY, WIND, JointState, Key, ends
from gcs_coloc.estimators.fleet.settings import FleetSettings

_CLEARLY_LESS = 0.9
_CLEARLY_MORE = 1.1
"""Chosen: a sigma within 10 % of the one in force is the same; every change costs two passes over the covariance."""
_INFLATION_TIME_S = 2.0
"""Chosen: a position error of d metres comes with a velocity error of d / 2 s, as of a turn that was missed for 2 s."""
_new = tuple.__new__


class Cluster:
    """The joint state of some vehicles, whose records it changes; clusters share `transition`."""

    __slots__ = ("joint", "records", "settings", "transition")

    def __init__(self, settings: FleetSettings, records: Records, transition: Transition, joint: JointState) -> None:
        self.settings = settings
        self.records = records
        self.transition = transition
        self.joint = joint

    def propagate(self, vehicle: int, at_s: float) -> None:
        """Propagate one vehicle to a later time; an earlier time and a static anchor change nothing."""
        joint = self.joint
        from_s = joint.time_s[vehicle]
        record = self.records[vehicle]
        if at_s <= from_s or record.static:
            return
        A, transition, where = joint.A, self.transition, joint.where[vehicle]
        P = A[where, where]
        for to_s in (at_s,) if record.in_one_step else step_ends(from_s, at_s):
            mean = set_transition(transition, record, self.settings, (A[0, where].tolist(), P), to_s - from_s, to_s)
            joint.propagate(vehicle, mean, transition.F, transition.Q, to_s)
            from_s = to_s

    def predict(self, vehicle: int, at_s: float) -> tuple[FloatArray, FloatArray]:
        """Return mean (16,) and covariance (16, 16) after, or shortly before, the time of a vehicle's states."""
        joint, transition, record = self.joint, self.transition, self.records[vehicle]
        x, P, from_s = joint.mean(vehicle), joint.covariance(vehicle), joint.time_s[vehicle]
        for to_s in step_ends(from_s, at_s) if at_s >= from_s else [at_s]:
            mean = set_transition(transition, record, self.settings, (x.tolist(), P), to_s - from_s, to_s)
            x = transition.F @ x
            x[: len(mean)] = mean
            P = transition.F @ P @ transition.F.T
            P += transition.Q
            from_s = to_s
        return x, P

    def position(self, vehicle: int) -> Vector3:
        """Return a vehicle's position at the time of its states, on the service's clock: p - tau v, eq. (10)."""
        x = self.joint.mean(vehicle).tolist()
        if self.records[vehicle].static:
            return x[0], x[1], x[2]
        offset_s = x[TIME_STAMP_OFFSET]
        return x[0] - offset_s * x[3], x[1] - offset_s * x[4], x[2] - offset_s * x[5]

    def range_end(self, vehicle: int) -> RangeEnd:
        """Return a vehicle as one end of a range."""
        where = self.joint.where[vehicle]
        x = self.joint.A[0, where].tolist()
        if self.records[vehicle].static:
            return RangeEnd(vehicle, where, (x[0], x[1], x[2]))
        offset_s, ve, vn, vu = x[TIME_STAMP_OFFSET], x[3], x[4], x[5]
        position = (x[0] - offset_s * ve, x[1] - offset_s * vn, x[2] - offset_s * vu)
        # As RangeEnd(...) does, at half the time.
        return _new(RangeEnd, (vehicle, where, position, (ve, vn, vu), offset_s))

    def between_references_m(self, m: RangeMeasurement) -> float:
        """Return a range without its lever arms by the states: of a body that turns it is smooth too, m."""
        if not any(m.offset_enu_m):
            return m.range_m
        here, there = self.position(m.from_vehicle), self.position(m.to_vehicle)
        return m.range_m - math.dist(here, m.virtual_end(m.to_vehicle, there)) + math.dist(here, there)

    def range_jacobian(self, a: RangeEnd, b: RangeEnd, unit: Vector3) -> FloatArray:
        """Return the Jacobian (4, 1 + n) of the vector `b` to `a` by states, along `unit`, east, north, up."""
        return range_jacobian(len(self.joint.A), a, b, unit)

    def peers_in_use(self, vehicle: int, at_s: float) -> dict[int, Vector3]:
        """Return the unit vectors from the peers whose ranges are in use at a time.

        A peer that was initialised anew has lost its range errors with its states: its earlier ranges tell nothing of it now.
        """
        neighbours, where = self.records[vehicle].neighbours, self.joint.where
        return {v: n.unit for v, n in neighbours.items() if abs(at_s - n.at_s) <= n.in_use_s and n.pair in where}

    def change_sigma(self, vehicle: int, where: slice, before: float, now: float) -> float:
        """Change the sigma of slow errors of a vehicle, and return the sigma now in force.

        `where` is the slice of these errors in the vehicle's block. A sigma within 10 % of `before` changes nothing.
        """
        if _CLEARLY_LESS * before <= now <= _CLEARLY_MORE * before:
            return before
        joint = self.joint
        start = joint.where[vehicle].start
        first, stop = start + where.start, start + where.stop
        if now < before:
            joint.scale(first, stop, now / before)
        else:
            # The additional error may have come all at once.
            joint.A[range(first, stop), range(first, stop)] += now * now - before * before
        return now

    def change_bias_sigma(self, pair: Key, before_m: float, now_m: float) -> None:
        """Change the sigma of a pair's bias, m; a pair without states has nothing to change."""
        joint = self.joint
        if pair not in joint.where:
            return
        start = joint.where[pair].start
        if now_m < before_m:
            joint.scale(start, start + 1, now_m / before_m)
        else:
            joint.A[start, start] += now_m * now_m - before_m * before_m

    def add_corrections(
        self, vehicle: int, W: FloatArray, innovations: Sequence[float], at_s: float, *, of_position: bool = False
    ) -> None:
        """Pass the velocity correction of one update to the manoeuvre detector.

        `W` (1 + n, k) and the k whitened `innovations` are those of the update. `of_position`: a range or a position report made
        it, so the noise level learns from it too.
        """
        record, s = self.records[vehicle], self.settings
        if record.static:
            return
        start = self.joint.where[vehicle].start + VELOCITY.start
        correction = (*W[start : start + 3].tolist(), innovations)
        record.manoeuvre.update(at_s, s.manoeuvre_memory_s, *correction)
        if of_position:
            noise, levels = record.manoeuvre_noise, record.profile.noise_levels
            if fresh_air_data(record, s, at_s) is not None:
                noise, levels = record.gust_noise, (s.least_noise_level, s.most_noise_level)
            noise.learn(at_s, s.noise_level_time_s, levels)
            noise.corrections.update(at_s, s.manoeuvre_memory_s, *correction)

    def inflate_covariance(self, vehicle: int, position_m2: float) -> None:
        """Add a position variance, m^2 on each axis, to the covariance of one vehicle.

        The variances of velocity and wind grow to match. The wind goes with the velocity: a wind learned from a false velocity
        would restore it with the next air data.
        """
        P, start = self.joint.A, self.joint.where[vehicle].start
        time2_s2 = _INFLATION_TIME_S * _INFLATION_TIME_S
        for axis in range(3):
            P[start + axis, start + axis] += position_m2
            P[start + 3 + axis, start + 3 + axis] += position_m2 / time2_s2
        for axis in (WIND.start, WIND.start + 1):
            P[start + axis, start + axis] += position_m2 / time2_s2

    def forget_air_errors(self, vehicle: int) -> None:
        """Reset wind, airspeed and heading error to the steady state of eq. (7), whatever air data showed."""
        joint = self.joint
        start = joint.where[vehicle].start
        first, stop = start + WIND.start, start + HEADING_ERROR + 1
        joint.scale(first, stop, 0.0)
        joint.A[range(first, stop), range(first, stop)] = steady_air_m2(self.settings)


class ClusterSet:
    """The clusters of one model, whose `records` and `settings` they have; none for who has no states."""

    __slots__ = ("_of", "_transition", "records", "settings")

    def __init__(self, settings: FleetSettings, records: Records, transition: Transition | None = None) -> None:
        self.settings = settings
        self.records = records
        self._of: dict[int, Cluster] = {}
        self._transition = Transition() if transition is None else transition

    def copy(self, records: Records) -> ClusterSet:
        """Return an independent copy for a model with the records given."""
        other = ClusterSet(self.settings, records, self._transition)
        clusters = {id(c): c for c in self._of.values()}
        copies = {key: other._cluster(c.joint.copy()) for key, c in clusters.items()}
        other._of = {vehicle: copies[id(c)] for vehicle, c in self._of.items()}
        return other

    def __contains__(self, vehicle: int) -> bool:
        return vehicle in self._of

    def __getitem__(self, vehicle: int) -> Cluster:
        return self._of[vehicle]

    def get(self, vehicle: int) -> Cluster | None:
        """Return a vehicle's cluster, None if it is in none."""
        return self._of.get(vehicle)

    def common(self, a: int, b: int) -> Cluster | None:
        """Return the cluster that holds both vehicles, None if none does."""
        cluster = self._of.get(a)
        return cluster if cluster is self._of.get(b) else None

    def members(self, vehicle: int) -> list[int]:
        """Return the vehicles in a vehicle's cluster, itself included."""
        cluster = self._of[vehicle]
        return [v for v, c in self._of.items() if c is cluster]

    def initialise(self, vehicle: int, mean: FloatArray, covariance: FloatArray, at_s: float) -> Cluster:
        """Initialise a cluster of one vehicle: mean (m,) and covariance (m, m) of its states at a time."""
        cluster = self._of[vehicle] = self._cluster(JointState())
        cluster.joint.augment(vehicle, mean, covariance, at_s)
        return cluster

    def add_copy(self, cluster: Cluster, vehicles: list[int]) -> None:
        """Add a copy of another model's cluster for its vehicles, which must be in none here."""
        self._of.update(dict.fromkeys(vehicles, self._cluster(cluster.joint.copy())))

    def merge(self, a: int, b: int) -> Cluster:
        """Return the cluster of both vehicles; merge theirs if they are in two."""
        first, second = self._of[a], self._of[b]
        if first is not second:
            if len(second.joint.A) > len(first.joint.A):
                first, second = second, first
            first.joint.augment_with(second.joint)
            for key in second.joint.where:
                if isinstance(key, Integral):
                    self._of[key] = first
        return first

    def remove(self, vehicle: int) -> None:
        """Marginalise a vehicle's states and the range errors of its pairs out of its cluster."""
        cluster = self._of.pop(vehicle, None)
        if cluster is None:
            return
        keys = [key for key in cluster.joint.where if vehicle not in ends(key)]
        cluster.joint = cluster.joint.marginalise(keys)

    def prune(self, links: Mapping[int, set[int]]) -> None:
        """Keep vehicles that are linked or denied; split clusters into the parts that links connect."""
        for vehicle in sorted(self._of):
            if not self.records[vehicle].denied_vehicle and vehicle not in links:
                self.remove(vehicle)
        seen: set[int] = set()
        for vehicle in sorted(self._of):
            if vehicle in seen:
                continue
            cluster = self._of[vehicle]
            linked, edge = {vehicle}, [vehicle]
            while edge:
                for other in links.get(edge.pop(), ()):
                    if other not in linked and self._of.get(other) is cluster:
                        linked.add(other)
                        edge.append(other)
            seen |= linked
            keys: list[Key] = []
            for key in cluster.joint.where:
                a, b = ends(key)
                if a in linked and (a == b or b in links.get(a, ())):
                    keys.append(key)
            if len(keys) < len(cluster.joint.where):
                part = self._cluster(cluster.joint.marginalise(keys))
                for member in linked:
                    self._of[member] = part

    def _cluster(self, joint: JointState) -> Cluster:
        return Cluster(self.settings, self.records, self._transition, joint)
