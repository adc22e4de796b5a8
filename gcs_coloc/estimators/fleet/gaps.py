"""Gaps: what a denied vehicle may have done while ranges told nothing of it, eq. (29) and (37).

A gap may be of one direction: the ranges along it have ceased, and the others go on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius
from gcs_coloc.core.measurements import FloatArray, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.ekf.possible_motion import HORIZONTAL, Motion, UnshownMotion, add_motion, unshown_motion
from gcs_coloc.estimators.fleet.ekf.process_model import (
    GAP_S,
    gap_covariance,
    motion_since,
    shown_acceleration_mps2,
    shows_its_motion,
)
from gcs_coloc.estimators.fleet.ekf.records import Neighbour, VehicleRecord
from gcs_coloc.estimators.fleet.search.position_search import is_too_wide
from gcs_coloc.estimators.fleet.settings import FleetSettings

_UNSHOWN_NIS = 9.0  # chosen: three sigmas; few ranges after a gap without an unusual manoeuvre are beyond
_TOLD_SIGMA_M = 5.0  # chosen: ranges tell of a direction along which the last of each neighbour know the position this well
_TOLD_RATIO = 3.0  # chosen: and of one along which they are so much coarser at most; where all are coarse, no gap is the cause
_NOTHING: Motion = (0.0, 0.0, 0.0)
_TOO_FEW, _TOO_FEW_WITHOUT_HEIGHT = 1, 2
"""So many neighbours leave a direction open: the vehicle may be anywhere on the circle of their ranges."""

Information = tuple[float, float, float]
"""Of ranges on the horizontal position, 1/m^2: east, east-north and north element."""


def add_gap(cluster: Cluster, vehicle: int, at_s: float) -> None:
    """Add to a denied vehicle's covariance what it may have done in a gap, eq. (29).

    The gap ends with a range at `at_s`. What goes beyond the manoeuvres that it has shown is kept until a range tells of it.
    """
    record, s = cluster.records[vehicle], cluster.settings
    possible = gap_covariance(record, s, at_s)
    if possible[0] == 0.0:
        _keep_partial_gap(cluster, record, at_s)
        return
    shown = gap_covariance(record, s, at_s, shown_acceleration_mps2(record, s))
    cluster.propagate(vehicle, at_s)
    add_motion(cluster.joint.covariance(vehicle), shown)
    record.unshown = unshown_motion(at_s, possible, shown)
    record.updated_at_s = record.gaps_added_until_s = at_s


def tell_of_all_directions(record: VehicleRecord) -> bool:
    """Return whether a denied vehicle has enough neighbours to tell of its motion in all directions."""
    return len(record.neighbours) > (_TOO_FEW if record.has_height else _TOO_FEW_WITHOUT_HEIGHT)


def untold_motion(record: VehicleRecord, s: FleetSettings, at_s: float) -> FloatArray | None:
    """Return the motion of a denied vehicle of which its neighbours are too few to tell, eq. (29).

    It is a covariance (4, 4) of position and velocity, to be stated beside that of the filter, which follows one of the ways that
    fit. None means that it is nothing. Without any neighbour all is one gap.
    """
    if not record.neighbours or tell_of_all_directions(record):
        return None
    possible = motion_since(record.told_at_s, record, s, at_s)
    if possible[0] == 0.0:
        return None
    untold = UnshownMotion(at_s, *possible)
    if record.has_height:
        ee, en, nn = _information(record.neighbours.values())
        untold = replace(untold, ee=ee, en=en, nn=nn)
    return untold.covariance(at_s)


def decide_unshown_motion(cluster: Cluster, vehicle: int, result: UpdateResult, m: RangeMeasurement) -> None:
    """Rule out by a range what a vehicle may have done in its last gap, or add it to the covariance."""
    record, at_s = cluster.records[vehicle], m.measured_at_s
    if record.unshown is None or result.degrees_of_freedom == 0:
        return
    if result.nis <= _UNSHOWN_NIS:
        if at_s - _known_until_s(cluster, m.other_end(vehicle), at_s) <= GAP_S:
            record.unshown = record.unshown.after_range(result.unit, result.sigma_m)
        return
    unshown = record.unshown.covariance(at_s)
    if is_too_wide(unshown.item(0, 0) + unshown.item(1, 1), m.range_m, m.sigma_m):
        unshown = record.unshown.not_ruled_out().covariance(at_s)
    cluster.joint.covariance(vehicle)[HORIZONTAL] += unshown
    record.unshown = None
    record.gaps_added_until_s = at_s


def _keep_partial_gap(cluster: Cluster, record: VehicleRecord, at_s: float) -> None:
    """Keep what a vehicle may have done since the ranges along one direction ceased.

    The ranges along the other direction go on. The process noise goes on holding the manoeuvres that it has shown.
    """
    s, told = cluster.settings, _last_told(cluster, record, at_s)
    both_until_s = _told_of_both_at_s(told)
    if shows_its_motion(record, s, at_s):
        record.told_at_s = at_s
    if both_until_s is None:
        return
    if tell_of_all_directions(record):
        record.told_at_s = max(record.told_at_s, both_until_s)
    record.gaps_added_until_s = max(record.gaps_added_until_s, both_until_s)
    possible = motion_since(record.gaps_added_until_s, record, s, at_s)
    if possible[0] == 0.0:
        return
    is_recurring = record.profile.is_recurring
    shown_mps2 = shown_acceleration_mps2(record, s)
    shown = motion_since(record.gaps_added_until_s, record, s, at_s, shown_mps2) if is_recurring else _NOTHING
    unshown = unshown_motion(at_s, possible, shown)
    if unshown is not None:
        ee, en, nn = _information([neighbour for known_s, neighbour in told if at_s - known_s <= GAP_S])
        record.unshown = replace(unshown, ee=ee, en=en, nn=nn)


def _last_told(cluster: Cluster, record: VehicleRecord, at_s: float) -> list[tuple[float, Neighbour]]:
    """Return each neighbour's last range with the time, s, until which it tells, the latest first."""
    told = [(min(n.at_s, _known_until_s(cluster, other, at_s)), n) for other, n in record.neighbours.items()]
    return sorted(told, key=lambda each: -each[0])


def _known_until_s(cluster: Cluster, vehicle: int, at_s: float) -> float:
    """Return until when the motion of a range's other end is known, s.

    That of a denied vehicle is known until its own last gap. So two of them do not vouch for each other.
    """
    record = cluster.records[vehicle]
    is_known = not record.denied_vehicle or shows_its_motion(record, cluster.settings, at_s)
    return at_s if is_known else record.gaps_added_until_s


def _told_of_both_at_s(told: Sequence[tuple[float, Neighbour]]) -> float | None:
    """Return until when, s, the last ranges told of both horizontal directions.

    None means that even all of them do not: then no gap is the cause.
    """
    for count, (known_s, _) in enumerate(told, start=1):
        mean, radius = eigenvalue_mean_and_radius(*_information([neighbour for _, neighbour in told[:count]]), math.hypot)
        least, most = mean - radius, mean + radius
        if least * _TOLD_SIGMA_M**2 >= 1.0 or (most > 0.0 and least * _TOLD_RATIO**2 >= most):
            return known_s
    return None


def _information(neighbours: Iterable[Neighbour]) -> Information:
    """Return the information of the last ranges to some neighbours."""
    ee = en = nn = 0.0
    for neighbour in neighbours:
        e, n = neighbour.unit[0] / neighbour.sigma_m, neighbour.unit[1] / neighbour.sigma_m
        ee, en, nn = ee + e * e, en + e * n, nn + n * n
    return ee, en, nn
