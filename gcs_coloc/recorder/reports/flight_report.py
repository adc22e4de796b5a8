"""The report of a replayed flight: GPS failures, messages sent, and the score of each vehicle while it was denied.

A position is scored at each true one, with what had arrived by then, as long as the vehicle's own GPS is not trusted.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED
from gcs_coloc.core.measurements import Estimate, Vector3
from gcs_coloc.core.messages.outbound import ExternalPosition, GlobalPositionSensor, GpsInput, HealthChanged, Notice, Outbound
from gcs_coloc.evaluation.scoring import VehicleScore, score, series_of
from gcs_coloc.recorder.side_tables import TruthPoint


@dataclass(slots=True)
class _Vehicle:
    changes: list[HealthChanged] = field(default_factory=list)
    fixes: int = 0
    no_fixes: int = 0
    external_positions: int = 0
    global_positions: int = 0
    epochs: list[tuple[float, Vector3, Estimate | None]] = field(default_factory=list)  # UNIX s, true east north up in m, answer


class FlightReport:
    """Collects a report during a replay, from `add_outputs` and `observe`. `truth` is what it scores against."""

    def __init__(self, engine: Engine, truth: list[TruthPoint]) -> None:
        self._engine = engine
        self._truth = truth
        self._next = 0
        self._vehicles: dict[int, _Vehicle] = {}
        self._errors: list[Notice] = []

    def observation_times(self) -> list[float]:
        """The service times (UNIX s) at which `observe` has to be called."""
        return sorted({point.unix_s for point in self._truth})

    def add_outputs(self, at_s: float, outputs: list[Outbound]) -> None:
        """Add the engine's outputs of one deadline."""
        del at_s
        for output in outputs:
            self._add(output)

    def _add(self, output: Outbound) -> None:
        if isinstance(output, HealthChanged):
            self._of(output.sysid).changes.append(output)
        elif isinstance(output, Notice):
            if output.level == "error":
                self._errors.append(output)
        elif isinstance(output, ExternalPosition):
            self._of(output.sysid).external_positions += 1
        elif isinstance(output, GlobalPositionSensor):
            self._of(output.sysid).global_positions += 1
        elif isinstance(output, GpsInput):
            vehicle = self._of(output.sysid)
            if output.fix_type >= 3:
                vehicle.fixes += 1
            else:
                vehicle.no_fixes += 1

    def observe(self, at_s: float) -> None:
        """VehicleScore every true position of this time."""
        while self._next < len(self._truth) and self._truth[self._next].unix_s <= at_s:
            self._score(self._truth[self._next])
            self._next += 1

    def score(self, sysid: int) -> VehicleScore | None:
        """The score of one vehicle, in two dimensions; None where its GPS was trusted throughout or there is no truth of it."""
        vehicle = self._vehicles.get(sysid)
        if vehicle is None or not vehicle.epochs:
            return None
        times_s, truth_enu_m, answers = zip(*vehicle.epochs, strict=True)
        return score(series_of(np.array(times_s), np.array(truth_enu_m), answers), times_s[0], dims=2)

    def as_dict(self) -> dict[str, Any]:
        """The report as plain values."""
        vehicles = []
        for sysid in sorted(self._engine.sysids()):
            mine = self._of(sysid)
            score = self.score(sysid)
            vehicles.append(
                {
                    "sysid": sysid,
                    "health": [asdict(change) for change in mine.changes],
                    "gps_input": {"fix": mine.fixes, "no_fix": mine.no_fixes},
                    "external_positions": mine.external_positions,
                    "global_positions": mine.global_positions,
                    "score": asdict(score) if score is not None else None,
                }
            )
        return {
            "vehicles": vehicles,
            "errors": [{"at_s": e.at_s, "sysid": e.sysid, "text": e.text} for e in self._errors],
            "refused": self._engine.refused(),
            "estimator_counts": dict(self._engine.estimator.counts()),
        }

    def _of(self, sysid: int) -> _Vehicle:
        return self._vehicles.setdefault(sysid, _Vehicle())

    def _score(self, point: TruthPoint) -> None:
        frame = self._engine.frame
        if frame is None or self._engine.gps_state(point.sysid) not in DISTRUSTED:
            return
        answer = self._engine.estimate(point.sysid, point.unix_s)
        truth_enu_m = frame.enu_from_geodetic(point.lat_deg, point.lon_deg, point.alt_msl_m)
        self._of(point.sysid).epochs.append((point.unix_s, truth_enu_m, answer if isinstance(answer, Estimate) else None))
