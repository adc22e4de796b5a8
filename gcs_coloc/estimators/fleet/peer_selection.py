"""The choice of the neighbours that locate a denied vehicle best, where there are more than are worth their cost."""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray
from gcs_coloc.estimators.fleet.cluster_set import ClusterSet
from gcs_coloc.estimators.fleet.ekf.records import Records
from gcs_coloc.estimators.fleet.settings import FleetSettings

_CHOICE_HOLDS_S = 2.0
_STAY_BONUS = 1.2
_SHARED_BONUS = 1.5
_PRIOR_INFORMATION = 1e-3


def is_selected(clusters: ClusterSet, records: Records, denied_vehicle: int, other: int, at_s: float, s: FleetSettings) -> bool:
    """Whether another vehicle is among the at most K neighbours that a denied vehicle uses; chooses anew every 2 s.

    The denied vehicle's record is changed: it is to be the model's own.
    """
    record = records[denied_vehicle]
    if other not in record.selected_peers and len(record.last_range_s) <= s.peers_per_subject:
        record.selected_peers = frozenset(record.last_range_s)
    if at_s - record.selected_at_s >= _CHOICE_HOLDS_S:
        record.selected_at_s = at_s
        fresh = sorted(v for v, t in record.last_range_s.items() if at_s - t <= s.peer_fresh_s)
        few = len(fresh) <= s.peers_per_subject
        record.selected_peers = (
            frozenset(fresh) if few else _select(clusters, records, denied_vehicle, fresh, s.peers_per_subject)
        )
    return other in record.selected_peers


def _select(clusters: ClusterSet, records: Records, denied_vehicle: int, fresh: list[int], most: int) -> frozenset[int]:
    here, record = _roughly(clusters, records, denied_vehicle), records[denied_vehicle]
    placed = [(v, there) for v in fresh if (there := _roughly(clusters, records, v)) is not None]
    if here is None or len(placed) <= most:
        return frozenset([v for v, _ in placed][:most])
    denied = {vehicle: other for vehicle, other in records.items() if other.denied_vehicle}
    used = (other.selected_peers for vehicle, other in denied.items() if vehicle != denied_vehicle)
    shared = frozenset().union(*used) - denied.keys()
    height_known = any(isinstance(m, AltitudeMeasurement) for m in record.recent_own)
    return select_peers(here, placed, record.selected_peers, shared, most, height_known=height_known)


def _roughly(clusters: ClusterSet, records: Records, vehicle: int) -> FloatArray | None:
    cluster, record = clusters.get(vehicle), records[vehicle]
    if cluster is not None:
        return cluster.joint.mean(vehicle)[:3]
    return np.array(record.last_position.position_enu_m) if record.last_position is not None else None


def select_peers(
    here: FloatArray,
    placed: list[tuple[int, FloatArray]],
    kept: frozenset[int],
    shared: frozenset[int],
    most: int,
    *,
    height_known: bool,
) -> frozenset[int]:
    """Choose at most `most` peers greedily: each next one is that which lowers the trace of the position cofactor most.

    Args:
        here: (3,) where the denied vehicle is, ENU in metres.
        placed: candidates with their positions (3,), in a fixed order (ties go to the first).
        kept: those in use now; another one has to be clearly better to replace one, for each change costs correlations.
        shared: those that other denied vehicles use: any other one has to be carried for this denied vehicle alone.
        most: how many may be used.
        height_known: whether the denied vehicle tells its own height, which is then worth a range from straight above.

    """
    there = np.array([position for _, position in placed])
    d = here - there
    units = d / np.maximum(np.linalg.norm(d, axis=1), 1e-9)[:, np.newaxis]
    bonus = np.array([(_STAY_BONUS if v in kept else 1.0) * (_SHARED_BONUS if v in shared else 1.0) for v, _ in placed])
    cofactor = np.diag([1.0, 1.0, _PRIOR_INFORMATION if height_known else 1.0]) / _PRIOR_INFORMATION
    free = np.ones(len(placed), dtype=bool)
    selected: list[int] = []
    for _ in range(min(most, len(placed))):
        cu = units @ cofactor
        lowered = np.einsum("ij,ij->i", cu, cu) / (1.0 + np.einsum("ij,ij->i", cu, units))
        best = int(np.argmax(np.where(free, lowered * bonus, -1.0)))
        free[best] = False
        selected.append(placed[best][0])
        g = cu[best]
        cofactor = cofactor - np.outer(g, g) / (1.0 + float(g @ units[best]))
    return frozenset(selected)
