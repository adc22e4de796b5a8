"""Improvement of a plan: the one change that helps its worst vehicle most.

The change is that of a start, a route or a station. All candidates are compared by geometry alone; the best three of each kind
are predicted with the filter, and the best of these is named with its gain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.planning.assessment import Assessment, Outlook, outlook
from gcs_coloc.planning.fleet_plan import FleetPlan, PlannedStation, PlannedVehicle
from gcs_coloc.planning.flight_path import FlightPath
from gcs_coloc.planning.prediction import predict
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers, run_tasks

_SHIFTS_S = (-120.0, -60.0, -30.0, 30.0, 60.0, 120.0)  # chosen: what an operator would try
_ASIDE_SHARES = (0.1, 0.25)
"""Of the plan's extent: how far a route is moved to a side."""
_LEAST_ASIDE_M = 50.0  # chosen: less changes no geometry
_GRID = 5
"""Stations tried on a grid of so many by so many places over the plan."""
_STATION_HEIGHT_M = 10.0
"""Above the lowest waypoint: a mast."""
_TIMES = 120
"""Chosen: times at which geometry is compared."""
_PREDICTED = 3
"""Candidates of each kind that are predicted. Chosen: geometry misjudges neighbours; nine predictions cost as nine vehicles."""
_ENOUGH = 0.999  # chosen: nothing is left to gain
_SPARE_FROM = 2.0 / 3.0
"""Share of the alert limit up to which a level is good. Chosen: levels of flights scatter by a fifth about it."""
_MOST_VEHICLES = 20
"""Chosen: of a larger plan only the worst vehicle and those nearest to its worst stretch are moved."""


class ChangeKind(StrEnum):
    """What is changed."""

    START = "start"
    ROUTE = "route"
    STATION = "station"


@dataclass(frozen=True, slots=True)
class Change:
    """One change of a plan: in words, and the plan with it."""

    kind: ChangeKind
    text: str
    plan: FleetPlan


@dataclass(frozen=True, slots=True)
class Improvement:
    """The change that helps a vehicle most, and what is predicted of the vehicle before and after it."""

    sysid: int
    change: Change
    before: Outlook
    after: Outlook

    @property
    def text(self) -> str:
        """The change and its gain in words."""
        old, new = (f"{each.predicted.share_with_fix:.1%}" for each in (self.before, self.after))
        fix = f"vehicle {self.sysid} has a fix for {new} of its flight" + (f" instead of {old}" if old != new else "")
        levels = f"median protection level {self.after.median_hpl_m:.0f} m instead of {self.before.median_hpl_m:.0f} m"
        return f"{self.change.text}: {fix}, {levels}"


def find_improvement(
    assessed: Assessment, workers: Workers, progress: Progress, kept: KeptResults | None = None
) -> Improvement | None:
    """Return the change that helps the worst vehicle most, or None where none helps.

    What `kept` holds is not computed again.
    """
    worst = assessed.worst
    if _is_enough(assessed):
        return None
    best = _best_by_geometry(assessed, worst)
    found = run_tasks(partial(_predict_change, worst.predicted.sysid), best, workers, progress, kept)
    change, after = max(zip(best, found, strict=True), key=lambda pair: _merit(pair[1]))
    return Improvement(worst.predicted.sysid, change, worst, after) if _merit(after) > _merit(worst) + 1e-3 else None


def no_improvement(assessed: Assessment) -> str:
    """Return the sentence that no change helps, or an empty text where none is needed.

    The assessment is one for which no change was found.
    """
    if _is_enough(assessed):
        return ""
    sysid = assessed.worst.predicted.sysid
    return f"No shifted start, no route to the side and no single station on a grid helps vehicle {sysid}."


def _is_enough(assessed: Assessment) -> bool:
    """Whether the worst vehicle has a fix all along, with a third of the alert limit to spare.

    It is enough as well where none flies at all.
    """
    worst, limit_m = assessed.worst, assessed.plan.assumptions.alert_limit_m
    return worst.worst is None or (worst.predicted.share_with_fix >= _ENOUGH and worst.worst.hpl_m < _SPARE_FROM * limit_m)


def _merit(outlook: Outlook) -> float:
    """Return the share with a fix, less 0.001 for each ten metres of protection level.

    So the level decides between equal shares.
    """
    level_m = float(np.nan_to_num(outlook.median_hpl_m, nan=1e3))
    return outlook.predicted.share_with_fix - 1e-4 * min(level_m, 1e3)


def _predict_change(sysid: int, change: Change) -> Outlook:
    (predicted,) = predict(change.plan, (sysid,))
    return outlook(predicted)


def _best_by_geometry(assessed: Assessment, worst: Outlook) -> list[Change]:
    """Return the best changes of each kind by geometry."""
    sysid = worst.predicted.sysid
    ranked: dict[ChangeKind, list[tuple[float, Change]]] = {kind: [] for kind in ChangeKind}
    for change in candidates(assessed.plan, worst):
        several = ranked[change.kind]
        several.append((_badness(change.plan, sysid, change.plan.paths[sysid]), change))
        several.sort(key=lambda each: each[0])
        del several[_PREDICTED:]
    return [change for several in ranked.values() for _, change in several]


def candidates(plan: FleetPlan, worst: Outlook) -> Iterator[Change]:
    """Yield all changes that are compared."""
    places = np.concatenate([path.positions_m for path in plan.paths.values()])
    low, high = places.min(axis=0), places.max(axis=0)
    extent_m = float(max(high[0] - low[0], high[1] - low[1]))
    for vehicle in _movable(plan, worst):
        for shift_s in _SHIFTS_S:
            start_s = vehicle.start_s + shift_s
            if start_s >= 0.0:
                text = f"start vehicle {vehicle.sysid} {abs(shift_s):.0f} s {'later' if shift_s > 0.0 else 'earlier'}"
                end_s = vehicle.end_s + shift_s if vehicle.end_s is not None else None
                yield Change(ChangeKind.START, text, plan.with_vehicle(replace(vehicle, start_s=start_s, end_s=end_s)))
        for share in _ASIDE_SHARES:
            aside_m = round(max(share * extent_m, _LEAST_ASIDE_M), -1)
            for side, east, north in (("east", 1, 0), ("west", -1, 0), ("north", 0, 1), ("south", 0, -1)):
                text = f"fly the route of vehicle {vehicle.sysid} {aside_m:.0f} m farther {side}"
                yield Change(ChangeKind.ROUTE, text, plan.with_vehicle(_moved(vehicle, east * aside_m, north * aside_m)))
    free = next(k for k in range(1, 1000) if all(station.station_id != k for station in plan.stations))
    for east in np.linspace(low[0], high[0], _GRID):
        for north in np.linspace(low[1], high[1], _GRID):
            place = (float(east), float(north), float(low[2]) + _STATION_HEIGHT_M)
            lat, lon, alt_m = plan.frame.geodetic_from_enu(*place)
            station = PlannedStation(free, place)
            text = f"a station at {lat:.6f},{lon:.6f},{alt_m:.0f}, known to {station.sigma_m:g} m"
            yield Change(ChangeKind.STATION, text, plan.with_station(station))


def _movable(plan: FleetPlan, worst: Outlook) -> list[PlannedVehicle]:
    """Return the worst vehicle and the others; of many those nearest to it in its worst stretch."""
    itself = plan.vehicle(worst.predicted.sysid)
    others = [vehicle for vehicle in plan.vehicles if vehicle.sysid != worst.predicted.sysid]
    if len(others) <= _MOST_VEHICLES or worst.worst is None:
        return [itself, *others]
    middle_s = 0.5 * (worst.worst.from_s + worst.worst.until_s)
    here = plan.paths[worst.predicted.sysid].position(middle_s)
    others.sort(key=lambda v: float(np.linalg.norm(plan.paths[v.sysid].position(middle_s) - here)))
    return [itself, *others[:_MOST_VEHICLES]]


def _moved(vehicle: PlannedVehicle, east_m: float, north_m: float) -> PlannedVehicle:
    """Return a vehicle with all waypoints moved, but not the place where it begins."""
    return replace(vehicle, legs=tuple(leg.moved(east_m, north_m) for leg in vehicle.legs))


def _badness(plan: FleetPlan, sysid: int, path: FlightPath) -> float:
    """Return the mean horizontal sigma of single fixes along the way, m: the less, the better.

    Each sigma counts as the alert limit at most.
    """
    a = plan.assumptions
    times = np.linspace(path.begin_s, path.end_s, _TIMES)
    here = _positions(path, times)
    ee, en, nn = np.zeros(_TIMES), np.zeros(_TIMES), np.zeros(_TIMES)
    peers = [(_positions(peer, times), a.position_sigma_m, peer) for other, peer in plan.paths.items() if other != sysid]
    rows = [(where, sigma_m, (times >= peer.begin_s) & (times <= peer.end_s)) for where, sigma_m, peer in peers]
    always = np.ones(_TIMES, dtype=bool)
    rows += [(np.broadcast_to(s.position_enu_m, here.shape), s.sigma_m, always) for s in plan.stations]
    for where, sigma_m, is_there in rows:
        d = here - where
        length = np.maximum(np.linalg.norm(d, axis=1), 1.0)
        weight = np.where(is_there & (length <= a.max_range_m), 1.0 / (a.range_sigma_m**2 + sigma_m**2), 0.0)
        ue, un = d[:, 0] / length, d[:, 1] / length
        ee, en, nn = ee + weight * ue * ue, en + weight * ue * un, nn + weight * un * un
    mean, radius = eigenvalue_mean_and_radius(ee, en, nn, np.hypot)
    # The smaller eigenvalue of the information, that of the worst direction.
    return float(np.minimum(1.0 / np.sqrt(np.maximum(mean - radius, 1e-9)), a.alert_limit_m).mean())


def _positions(path: FlightPath, times: FloatArray) -> FloatArray:
    place = np.clip(np.round((times - path.begin_s) / (path.end_s - path.begin_s) * (len(path.positions_m) - 1)), 0, None)
    return np.asarray(path.positions_m[np.minimum(place.astype(int), len(path.positions_m) - 1)])
