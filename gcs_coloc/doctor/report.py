"""What the doctor says, as text for the operator and as JSON for programs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gcs_coloc.doctor.checks import is_ready, of_fleet, of_vehicle
from gcs_coloc.doctor.finding import Finding, FleetSurvey, Setup, Severity

_ORDER = (Severity.STOP, Severity.NOTE, Severity.RIGHT)
_MARKS = {Severity.STOP: "STOP ", Severity.NOTE: "note ", Severity.RIGHT: "right"}


class Report:
    """The doctor's findings on a fleet."""

    def __init__(self, survey: FleetSurvey, setup: Setup) -> None:
        fleet = frozenset(vehicle.sysid for vehicle in survey.vehicles)
        self._seconds = survey.seconds
        self._vehicles = [(vehicle, of_vehicle(vehicle, setup, fleet)) for vehicle in survey.vehicles]
        self._fleet = of_fleet(survey, setup)

    @property
    def is_ready(self) -> bool:
        """Whether nothing was found that would stop co-localisation."""
        return is_ready(self._fleet) and all(is_ready(findings) for _, findings in self._vehicles)

    def lines(self) -> Iterator[str]:
        """The report for reading: what stops first, and the result last."""
        for vehicle, findings in self._vehicles:
            yield f"vehicle {vehicle.sysid}: {vehicle.autopilot.value}, {'armed' if vehicle.armed else 'not armed'}"
            yield from _lines(findings)
        yield "fleet"
        yield from _lines(self._fleet)
        yield self._result()

    def as_json(self) -> dict[str, Any]:
        """The report as a JSON object, see docs/reference/command-line.md."""
        return {
            "seconds": self._seconds,
            "ready": self.is_ready,
            "vehicles": [
                {
                    "sysid": vehicle.sysid,
                    "autopilot": vehicle.autopilot.value,
                    "ready": is_ready(findings),
                    "findings": [_as_json(finding) for finding in findings],
                    "parameters": dict(sorted(vehicle.parameters.items())),
                }
                for vehicle, findings in self._vehicles
            ],
            "fleet": [_as_json(finding) for finding in self._fleet],
        }

    def _result(self) -> str:
        if self.is_ready:
            return "result: all right; co-localisation can work"
        stopped = [str(vehicle.sysid) for vehicle, findings in self._vehicles if not is_ready(findings)]
        whom = f"vehicle {', '.join(stopped)}" if stopped else "the fleet"
        return f"result: something would stop co-localisation of {whom}"


def _lines(findings: list[Finding]) -> Iterator[str]:
    for finding in sorted(findings, key=lambda finding: _ORDER.index(finding.severity)):
        yield f"  {_MARKS[finding.severity]}  {finding.text}{f'; {finding.remedy}' if finding.remedy else ''}"


def _as_json(finding: Finding) -> dict[str, Any]:
    name, value = finding.parameter if finding.parameter is not None else (None, None)
    return {
        "severity": finding.severity.value,
        "text": finding.text,
        "remedy": finding.remedy,
        "set": {name: value} if name else None,
    }
