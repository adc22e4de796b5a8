"""Parameter files: what the doctor would set on a vehicle, for ground stations to load."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.doctor.finding import Setup, VehicleSurvey
from gcs_coloc.doctor.report import of_vehicle
from gcs_coloc.runtime.files import make_output_directory, writing

_REAL32 = 9
"""MAV_PARAM_TYPE_REAL32 (MAVLink common.xml)."""
_AUTOPILOT_COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""


def parameters_to_set(vehicle: VehicleSurvey, setup: Setup, fleet: frozenset[int]) -> dict[str, tuple[float, str]]:
    """Return each parameter that the doctor would set, by its name: the value and why.

    Changes are tried one after the other: two findings may concern bits of one parameter.
    """
    parameters, changes = dict(vehicle.parameters), dict[str, tuple[float, str]]()
    for _ in range(2 * len(parameters)):  # none is changed more often than twice; a pair of rules that disagrees must end
        tried = of_vehicle(replace(vehicle, parameters=parameters), setup, fleet)
        open_findings = [(one, *one.parameter) for one in tried if one.parameter is not None]
        open_findings = [found for found in open_findings if parameters.get(found[1]) != found[2]]
        if not open_findings:
            break
        finding, name, value = open_findings[0]
        before = f"{changes[name][1]}; " if name in changes else ""
        parameters[name] = value
        changes[name] = value, f"{before}{finding.text}"
    return changes


def write_parameter_files(directory: Path, vehicles: tuple[VehicleSurvey, ...], setup: Setup) -> Iterator[Path]:
    """Write the files of the vehicles that need one; return their paths.

    Raises:
        UsageError: a file cannot be written; the text says why.
    """
    fleet = frozenset(vehicle.sysid for vehicle in vehicles)
    make_output_directory(directory, "--write-params")
    with writing(directory, "--write-params"):
        for vehicle in vehicles:
            changes = parameters_to_set(vehicle, setup, fleet)
            for name, text in _files(vehicle, changes).items():
                path = directory / name
                path.write_text(text, encoding="ascii", errors="replace")
                yield path


def _files(vehicle: VehicleSurvey, changes: Mapping[str, tuple[float, str]]) -> dict[str, str]:
    """The text of each file by its name; empty where there is nothing to set."""
    if not changes:
        return {}
    name, files = f"vehicle-{vehicle.sysid}", {}
    if vehicle.autopilot is Autopilot.ARDUPILOT:
        files[f"{name}.param"] = "".join(_mission_planner_lines(vehicle, changes))
    files[f"{name}.params"] = "".join(_qgroundcontrol_lines(vehicle, changes))
    return files


def _mission_planner_lines(vehicle: VehicleSurvey, changes: Mapping[str, tuple[float, str]]) -> Iterator[str]:
    """Yield the lines of Mission Planner's and MAVProxy's format: NAME,VALUE."""
    yield f"# gcs-coloc doctor: vehicle {vehicle.sysid}, {vehicle.autopilot.value}\n"
    for name, (value, why) in changes.items():
        yield f"# {why}\n{name},{value:.9g}\n"


def _qgroundcontrol_lines(vehicle: VehicleSurvey, changes: Mapping[str, tuple[float, str]]) -> Iterator[str]:
    """Yield the lines of QGroundControl's format: five fields with tabs between.

    The last field is the MAV_PARAM_TYPE. Source: QGroundControl's developer guide, Parameters File Format.
    """
    yield f"# Onboard parameters for Vehicle {vehicle.sysid}\n#\n"
    for why in (why for _, why in changes.values()):
        yield f"# {why}\n"
    yield "#\n# Vehicle-Id Component-Id Name Value Type\n"
    for name, (value, _) in changes.items():
        kind = vehicle.parameter_kinds.get(name, _REAL32)
        yield f"{vehicle.sysid}\t{_AUTOPILOT_COMPONENT}\t{name}\t{value:.9g}\t{kind}\n"
