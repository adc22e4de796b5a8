"""Peer selection: the neighbours that locate a denied vehicle best.

They are selected where there are more than are worth their cost.
"""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray
from gcs_coloc.estimators.fleet.ekf.cluster import ClusterSet

_SELECT_EVERY_S = 2.0  # chosen: each change costs correlations; geometry changes little in 2 s
_STAY_BONUS = 1.2  # chosen: a new peer has to lower the variance by a fifth more than one in use
_SHARED_BONUS = 1.5  # chosen: a peer in use by another denied vehicle saves 16 states
_PRIOR_INFORMATION = 1e-3  # chosen: makes the cofactor matrix regular; small against one range, whose information is 1


def is_selected(clusters: ClusterSet, denied_vehicle: int, other: int, at_s: float) -> bool:
    """Return whether a denied vehicle (of a writable record) uses another's ranges; select every 2 s."""
    record, s = clusters.records[denied_vehicle], clusters.settings
    if other not in record.selected_peers and len(record.last_range_s) <= s.peers_per_denied_vehicle:
        record.selected_peers = frozenset(record.last_range_s)
    if at_s - record.selected_at_s >= _SELECT_EVERY_S:
        record.selected_at_s = at_s
        fresh = sorted(v for v, t in record.last_range_s.items() if at_s - t <= s.peer_fresh_s)
        few = len(fresh) <= s.peers_per_denied_vehicle
        record.selected_peers = frozenset(fresh) if few else _select_anew(clusters, denied_vehicle, fresh)
    return other in record.selected_peers


def _select_anew(clusters: ClusterSet, denied_vehicle: int, fresh: list[int]) -> frozenset[int]:
    here, record = rough_position(clusters, denied_vehicle), clusters.records[denied_vehicle]
    placed = [(v, there) for v in fresh if (there := rough_position(clusters, v)) is not None]
    most = clusters.settings.peers_per_denied_vehicle
    if here is None or len(placed) <= most:
        return frozenset([v for v, _ in placed][:most])
    denied = {vehicle: other for vehicle, other in clusters.records.items() if other.denied_vehicle}
    used = (other.selected_peers for vehicle, other in denied.items() if vehicle != denied_vehicle)
    shared = frozenset().union(*used) - denied.keys()
    height_known = any(isinstance(m, AltitudeMeasurement) for m in record.recent_own)
    return select_peers(here, placed, record.selected_peers, shared, most, height_known=height_known)


def rough_position(clusters: ClusterSet, vehicle: int) -> FloatArray | None:
    """Return the position (3,) of a vehicle's states, m, else the last reported one, else None."""
    cluster, record = clusters.get(vehicle), clusters.records.get(vehicle)
    if record is None:
        return None
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
    """Select at most `most` peers greedily: each next one lowers the trace of the position cofactor most.

    The vehicle is at `here` (3,), m, the candidates are where they are `placed`; ties go to the first. To replace one of the
    `kept`, which are in use, another one has to be clearly better. One that is not `shared` with other denied vehicles adds
    states for this one alone. A known height is worth a range from straight above.
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
