"""Several plan files as one plan: a common frame, system ids, start times, stations, assumptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3, VehicleClass
from gcs_coloc.planning.fleet_plan import FleetPlan, PlanAssumptions, PlannedStation, PlannedVehicle
from gcs_coloc.planning.flight_path import Leg
from gcs_coloc.planning.mission import FAR_M, LatLonAlt, ListedStation, Mission, MissionFile, PerVehicle
from gcs_coloc.planning.plan_files import read_plan_file


def load_plan(
    files: Sequence[Path],
    *,
    classes: PerVehicle[VehicleClass] | None = None,
    speeds_mps: PerVehicle[float] | None = None,
    starts_s: Mapping[int, float] | None = None,
    stations: Sequence[ListedStation] = (),
    assumed: Mapping[str, Any] | None = None,
) -> FleetPlan:
    """Read plan files, one a vehicle (a scenario may have several), numbered 1, 2, ... in their order.

    Args:
        files: in the order of the vehicles' system ids; a scenario has its own.
        classes: how vehicles move; of whom neither this nor a file says so: as planes.
        speeds_mps: how fast they fly.
        starts_s: when vehicles start, by system id, s; others at 0.
        stations: further stations.
        assumed: fields of `PlanAssumptions` that differ from the files' and the defaults.

    Raises:
        DataError: a file is malformed; the text names file, item and what was expected.
        UsageError: what is asked for does not fit the files.

    """
    classes, speeds, starts = classes or PerVehicle(), speeds_mps or PerVehicle(), dict(starts_s or {})
    read = [read_plan_file(path, PerVehicle(classes.of_all), PerVehicle(speeds.of_all)) for path in files]
    sysids = _sysids(read)
    known = sorted(sysid for several in sysids for sysid in several)
    for option, told in (("--start", starts), ("--speed", speeds.of_one), ("--class", classes.of_one)):
        for sysid in told:
            if sysid not in known:
                raise UsageError(f"{option} {sysid}=...: there is no vehicle {sysid}; there are {', '.join(map(str, known))}")
    if classes.of_one or speeds.of_one:
        # How long it circles depends on both, and its number on all files.
        read = [read_plan_file(path, classes, speeds, its[0]) for path, its in zip(files, sysids, strict=True)]
    missions = [mission for file in read for mission in file.missions]
    frame = LocalFrame(*missions[0].begin)
    numbered = dict(sorted(zip((sysid for several in sysids for sysid in several), missions, strict=True)))
    vehicles = tuple(_vehicle(sysid, mission, frame, starts.get(sysid, 0.0)) for sysid, mission in numbered.items())
    return FleetPlan(
        frame,
        vehicles,
        _stations(read, stations, frame),
        _assumptions(read, assumed or {}),
        tuple(r for f in read for r in f.remarks),
    )


def _sysids(read: Sequence[MissionFile]) -> list[list[int]]:
    """Return the system ids of the missions of each file."""
    names: dict[int, str] = {}
    taken = {mission.sysid for file in read for mission in file.missions}
    free = (sysid for sysid in count(1) if sysid not in taken)
    found: list[list[int]] = []
    for file in read:
        found.append([])
        for mission in file.missions:
            sysid = mission.sysid if mission.sysid is not None else next(free)
            if sysid in names:
                raise UsageError(f"{mission.name} and {names[sysid]} both have the system id {sysid}")
            names[sysid] = mission.name
            found[-1].append(sysid)
    return found


def _vehicle(sysid: int, mission: Mission, frame: LocalFrame, start_s: float) -> PlannedVehicle:
    def enu(place: LatLonAlt) -> Vector3:
        east, north, up = frame.enu_from_geodetic(*place)
        if abs(east) > FAR_M or abs(north) > FAR_M:
            raise UsageError(
                f"{mission.name} has a place {max(abs(east), abs(north)) / 1e3:.0f} km from where the first plan begins, "
                f"expected one site within {FAR_M / 1e3:.0f} km"
            )
        return east, north, up

    legs = tuple(Leg(enu(leg.end), leg.speed_mps, leg.hold_s, leg.radius_m) for leg in mission.legs)
    end_s = start_s + mission.duration_s if mission.duration_s is not None else None
    return PlannedVehicle(sysid, mission.name, enu(mission.begin), legs, start_s, mission.vehicle_class, end_s)


def _stations(read: Sequence[MissionFile], listed: Sequence[ListedStation], frame: LocalFrame) -> tuple[PlannedStation, ...]:
    found: dict[int, PlannedStation] = {}
    for station_id, place, sigma_m in [*(each for file in read for each in file.stations), *listed]:
        if station_id in found:
            raise UsageError(f"two stations have the id {station_id}")
        found[station_id] = PlannedStation(station_id, frame.enu_from_geodetic(*place), sigma_m)
    return tuple(found.values())


def _assumptions(read: Sequence[MissionFile], assumed: Mapping[str, Any]) -> PlanAssumptions:
    base = next((file.assumptions for file in read if file.assumptions is not None), PlanAssumptions())
    try:
        return replace(base, **{name: value for name, value in assumed.items() if value is not None})
    except ValueError as error:
        raise UsageError(str(error)) from error
