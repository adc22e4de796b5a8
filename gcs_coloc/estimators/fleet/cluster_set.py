"""The clusters of a fleet: initialised with one vehicle, merged by the first range, marginalised when no range links them."""

from __future__ import annotations

from collections.abc import Mapping

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.ekf._kernels import Transition
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import JointState, Key
from gcs_coloc.estimators.fleet.settings import FleetSettings


class ClusterSet:
    """The clusters of one model, by vehicle; a vehicle without states is in none.

    `records` is shared with the model.
    """

    __slots__ = ("_of", "_records", "_settings", "_transition")

    def __init__(
        self, settings: FleetSettings, records: Mapping[int, VehicleRecord], transition: Transition | None = None
    ) -> None:
        self._settings = settings
        self._records = records
        self._of: dict[int, Cluster] = {}
        self._transition = Transition() if transition is None else transition

    def copy(self, records: Mapping[int, VehicleRecord]) -> ClusterSet:
        """Return an independent copy for a model with the records given."""
        other = ClusterSet(self._settings, records, self._transition)
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
                if isinstance(key, int):
                    self._of[key] = first
        return first

    def remove(self, vehicle: int) -> None:
        """Marginalise a vehicle's states and the range errors of its pairs out of its cluster."""
        cluster = self._of.pop(vehicle, None)
        if cluster is None:
            return
        keys: list[Key] = [
            key for key in cluster.joint.where if key != vehicle and not (isinstance(key, tuple) and vehicle in key[:2])
        ]
        cluster.joint = cluster.joint.marginalise(keys)

    def prune(self, links: Mapping[int, set[int]]) -> None:
        """Keep vehicles that are linked or denied; split clusters into the parts that links connect."""
        for vehicle in sorted(self._of):
            if not self._records[vehicle].denied_vehicle and vehicle not in links:
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
            keys: list[Key] = [
                key
                for key in cluster.joint.where
                if key in linked or (isinstance(key, tuple) and key[0] in linked and key[1] in links.get(key[0], ()))
            ]
            if len(keys) < len(cluster.joint.where):
                part = self._cluster(cluster.joint.marginalise(keys))
                for member in linked:
                    self._of[member] = part

    def _cluster(self, joint: JointState) -> Cluster:
        return Cluster(self._settings, self._records, self._transition, joint)
