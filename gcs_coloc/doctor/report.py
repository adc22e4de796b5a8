"""What the doctor says, as text for the operator and as JSON for programs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gcs_coloc.doctor.checks import is_ready, of_fleet, of_vehicle
from gcs_coloc.doctor.findings import Findings, Level, Remark, Setup

_ORDER = (Level.STOP, Level.NOTE, Level.RIGHT)
_MARKS = {Level.STOP: "STOP ", Level.NOTE: "note ", Level.RIGHT: "right"}


class Report:
    """The doctor's remarks on a fleet."""

    def __init__(self, findings: Findings, setup: Setup) -> None:
        fleet = frozenset(vehicle.sysid for vehicle in findings.vehicles)
        self._seconds = findings.seconds
        self._vehicles = [(vehicle, of_vehicle(vehicle, setup, fleet)) for vehicle in findings.vehicles]
        self._fleet = of_fleet(findings, setup)

    @property
    def is_ready(self) -> bool:
        """Whether nothing was found that would stop co-localisation."""
        return is_ready(self._fleet) and all(is_ready(remarks) for _, remarks in self._vehicles)

    def lines(self) -> Iterator[str]:
        """The report for reading: what stops first, and the result last."""
        for vehicle, remarks in self._vehicles:
            yield f"vehicle {vehicle.sysid}: {vehicle.autopilot.value}, {'armed' if vehicle.armed else 'not armed'}"
            yield from _lines(remarks)
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
                    "ready": is_ready(remarks),
                    "remarks": [_as_json(remark) for remark in remarks],
                    "parameters": dict(sorted(vehicle.parameters.items())),
                }
                for vehicle, remarks in self._vehicles
            ],
            "fleet": [_as_json(remark) for remark in self._fleet],
        }

    def _result(self) -> str:
        if self.is_ready:
            return "result: all right; co-localisation can work"
        stopped = [str(vehicle.sysid) for vehicle, remarks in self._vehicles if not is_ready(remarks)]
        whom = f"vehicle {', '.join(stopped)}" if stopped else "the fleet"
        return f"result: something would stop co-localisation of {whom}"


def _lines(remarks: list[Remark]) -> Iterator[str]:
    for remark in sorted(remarks, key=lambda remark: _ORDER.index(remark.level)):
        yield f"  {_MARKS[remark.level]}  {remark.text}{f'; {remark.mend}' if remark.mend else ''}"


def _as_json(remark: Remark) -> dict[str, Any]:
    name, value = remark.parameter if remark.parameter is not None else (None, None)
    return {"level": remark.level.value, "text": remark.text, "mend": remark.mend, "set": {name: value} if name else None}
