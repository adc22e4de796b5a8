"""The plans on which the prediction is checked, each with the vehicle that is denied.

There are ten, of different kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import cos, pi, sin
from typing import NamedTuple

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.planning.fleet_plan import FleetPlan, PlanAssumptions, PlannedStation, PlannedVehicle
from gcs_coloc.planning.flight_path import Leg
from gcs_coloc.planning.load import load_plan
from sitl_fakes.scenario import SCENARIOS

_FRAME = LocalFrame(47.0, 8.0, 500.0)
_DURATION_S = 300.0  # chosen: several legs
_SURVEYED_M = 0.1  # chosen: stations surveyed by RTK, of which the prediction takes shorter steps
_Points = Sequence[tuple[float, float]]


class CheckedPlan(NamedTuple):
    """One plan, who is denied in it, and what kind it is."""

    text: str
    denied: int
    plan: FleetPlan


def _vehicle(sysid: int, points: _Points, speed_mps: float = 20.0, kind: VehicleClass = VehicleClass.PLANE) -> PlannedVehicle:
    up_m = 80.0 + 15.0 * sysid
    legs = tuple(Leg((*point, up_m), speed_mps) for point in [*points[1:], *points] * 6)
    return PlannedVehicle(sysid, str(sysid), (*points[0], up_m), legs, 0.0, kind, _DURATION_S)


def _box(east: float, north: float, size: float) -> _Points:
    return [(east, north), (east + size, north), (east + size, north + size), (east, north + size)]


def _ring(east: float, north: float, radius: float, first: float) -> _Points:
    angles = [first + k * pi / 3.0 for k in range(6)]
    return [(east + radius * sin(a), north + radius * cos(a)) for a in angles]


def _fleet(*vehicles: PlannedVehicle, stations: _Points = (), **assumed: float | bool) -> FleetPlan:
    placed = tuple(PlannedStation(k, (*place, 15.0), _SURVEYED_M) for k, place in enumerate(stations, start=1))
    return FleetPlan(_FRAME, vehicles, placed, PlanAssumptions(**assumed))  # type: ignore[arg-type]


def _around() -> CheckedPlan:
    boxes = [_vehicle(k, _box(900.0 * (k % 2), 900.0 * (k // 2), 500.0)) for k in range(1, 5)]
    return CheckedPlan("four planes, each on a square of its own", 1, _fleet(*boxes))


def _abreast() -> CheckedPlan:
    lanes = [_vehicle(k, [(250.0 * k, 0.0), (250.0 * k, 2500.0)]) for k in range(1, 5)]
    return CheckedPlan("four planes abreast, to and fro", 1, _fleet(*lanes))


def _column() -> CheckedPlan:
    lanes = [_vehicle(k, [(20.0 * k, 300.0 * k), (20.0 * k, 300.0 * k + 2500.0)]) for k in range(1, 5)]
    return CheckedPlan("four planes in a column", 1, _fleet(*lanes))


def _far() -> CheckedPlan:
    rings = [_vehicle(k, _ring(3500.0 * (k % 2), 3500.0 * (k // 2), 400.0, k)) for k in range(1, 5)]
    return CheckedPlan("four planes far apart", 2, _fleet(*rings))


def _two_peers() -> CheckedPlan:
    return CheckedPlan(
        "two peers alone", 1, _fleet(*(_vehicle(k, _ring(700.0 * k, 300.0 * (k % 2), 350.0, 2.0 * k)) for k in range(1, 4)))
    )


def _without_air_data() -> CheckedPlan:
    boxes = [_vehicle(k, _box(900.0 * (k % 2), 900.0 * (k // 2), 500.0)) for k in range(1, 5)]
    return CheckedPlan("planes that send no airspeed", 1, _fleet(*boxes, has_air_data=False))


def _copters() -> CheckedPlan:
    kind = VehicleClass.MULTIROTOR
    rings = [_vehicle(k, _ring(250.0 * (k % 2), 250.0 * (k // 2), 150.0, k), 8.0, kind) for k in range(1, 6)]
    return CheckedPlan("five copters", 1, _fleet(*rings))


def _stations() -> CheckedPlan:
    places = [(-100.0, -100.0), (1300.0, 0.0), (1200.0, 1300.0), (0.0, 1200.0)]
    return CheckedPlan("one plane and four stations", 1, _fleet(_vehicle(1, _box(200.0, 200.0, 800.0)), stations=places))


def _coarse() -> CheckedPlan:
    boxes = [_vehicle(k, _box(1500.0 * (k % 2), 1500.0 * (k // 2), 700.0), 25.0) for k in range(1, 5)]
    return CheckedPlan("ranges of 5 m, receivers of 4 m", 3, _fleet(*boxes, range_sigma_m=5.0, position_sigma_m=4.0))


def _paper() -> CheckedPlan:
    return CheckedPlan("Qu and Zhang's flight", 4, load_plan([SCENARIOS / "paper.toml"]))


CHECK_PLANS: Mapping[str, Callable[[], CheckedPlan]] = {
    "around": _around,
    "abreast": _abreast,
    "column": _column,
    "far": _far,
    "two-peers": _two_peers,
    "no-air-data": _without_air_data,
    "copters": _copters,
    "stations": _stations,
    "coarse": _coarse,
    "paper": _paper,
}
"""The plans by name; each is built when asked for."""
