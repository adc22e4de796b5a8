"""The report of a replayed flight: GPS failures, messages sent, scores and findings.

The scores are those of denied vehicles. The findings are about the quality of the recorded data.

A position is scored at each true one, with what had arrived by then, as long as the vehicle's own GPS is not trusted.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.estimator import Estimator, LossQuery
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED
from gcs_coloc.core.measurements import (
    Estimate,
    FloatArray,
    Measurement,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
    Residual,
    Vector3,
)
from gcs_coloc.core.messages.outbound import (
    ExternalPosition,
    GlobalPositionSensor,
    GpsInput,
    HealthChanged,
    Notice,
    Outbound,
    VisionPosition,
)
from gcs_coloc.core.stations.node_id import node_name
from gcs_coloc.evaluation.data_checks.checks import run_checks
from gcs_coloc.evaluation.data_checks.findings import DataFinding, FindingKind, finding
from gcs_coloc.evaluation.data_checks.recorded_data import PositionTrack, RecordedData, position_track
from gcs_coloc.evaluation.scoring import VehicleScore, score, series_of
from gcs_coloc.recorder.side_tables import TruthPoint

_POSITION_EVERY_S = 0.5  # chosen: as dense as a plot shows
_RANGE_EVERY_S = 0.5  # chosen: as dense as a plot shows
MAX_ROWS = 1_000_000  # chosen: what a browser takes
_NO_VELOCITY = (float("nan"),) * 3
_ELSEWHERE_M = 100_000.0  # chosen: no range reaches so far


@dataclass(slots=True)
class _Vehicle:
    changes: list[HealthChanged] = field(default_factory=list)
    fixes: int = 0
    no_fixes: int = 0
    external_positions: int = 0
    global_positions: int = 0
    epochs: list[tuple[float, Vector3, Estimate | None]] = field(default_factory=list)  # UNIX s, true east north up in m, answer


class FlightReport:
    """The report of one flight, collected during its replay.

    `add_outputs` and `observe` collect it. `truth` is what it scores against.
    """

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
        elif isinstance(output, GlobalPositionSensor | VisionPosition):
            self._of(output.sysid).global_positions += 1
        elif isinstance(output, GpsInput):
            vehicle = self._of(output.sysid)
            if output.fix_type >= 3:
                vehicle.fixes += 1
            else:
                vehicle.no_fixes += 1

    def observe(self, at_s: float) -> None:
        """Score every true position up to this time (UNIX s) that has not been scored yet."""
        while self._next < len(self._truth) and self._truth[self._next].unix_s <= at_s:
            self._score(self._truth[self._next])
            self._next += 1

    def score(self, sysid: int) -> VehicleScore | None:
        """Return the score of one vehicle in two dimensions; None where it was not scored.

        A vehicle is scored at each of its true positions while its GPS is not trusted.
        """
        vehicle = self._vehicles.get(sysid)
        if vehicle is None or not vehicle.epochs:
            return None
        times_s, truth_enu_m, answers = zip(*vehicle.epochs, strict=True)
        return score(series_of(np.array(times_s), np.array(truth_enu_m), answers), times_s[0], dims=2)

    def beyond_protection_level(self, sysid: int) -> float | None:
        """Return the share of a vehicle's estimates whose error is beyond their protection level.

        Error and protection level are horizontal. Scored estimates with a level count; None where there are none.
        """
        beyond = [
            np.hypot(*np.subtract(answer.position_enu_m[:2], true_enu_m[:2])) > answer.protection.horizontal_m
            for _, true_enu_m, answer in self._of(sysid).epochs
            if answer is not None and answer.protection is not None
        ]
        return float(np.mean(beyond)) if beyond else None

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


_PredictLoss = Callable[[LossQuery], Sequence[Estimate | NoEstimate]]


class MeasurementTap:
    """An estimator around another one that keeps its measurements for the data checks.

    Of the positions and ranges that pass through it keeps two a second at most for each vehicle and pair, and the first
    million altogether.
    """

    def __init__(self, inner: Estimator) -> None:
        self._inner = inner
        self.predict_loss: _PredictLoss | None = getattr(inner, "predict_loss", None)
        """As `PredictsLoss` says, None where the inner estimator does not predict."""
        self._positions: dict[int, array[float]] = defaultdict(lambda: array("d"))
        self._static: dict[int, PositionTrack] = {}
        self._ranges = array("d")
        self._next_s: dict[tuple[int, int], float] = {}
        self._rows = 0

    @property
    def name(self) -> str:
        """The inner estimator's name."""
        return self._inner.name

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        """As the protocol says."""
        self._inner.set_denied(denied, at_s)

    def reset(self, vehicle: int, at_s: float) -> None:
        """As the protocol says."""
        self._inner.reset(vehicle, at_s)

    def add(self, measurement: Measurement) -> None:
        """As the protocol says."""
        m = measurement
        if isinstance(m, PositionMeasurement) and m.static:
            self._static[m.vehicle] = PositionTrack(
                np.zeros(1), np.array([m.position_enu_m]), np.array([m.sigma_h_m]), is_static=True
            )
        elif isinstance(m, PositionMeasurement) and self._is_due((m.vehicle, m.vehicle), m.measured_at_s, _POSITION_EVERY_S):
            velocity = m.velocity_enu_mps or _NO_VELOCITY
            self._positions[m.vehicle].extend((m.measured_at_s, *m.position_enu_m, m.sigma_h_m, *velocity))
        elif isinstance(m, RangeMeasurement) and self._is_due((m.from_vehicle, m.to_vehicle), m.measured_at_s, _RANGE_EVERY_S):
            self._ranges.extend((m.measured_at_s, m.from_vehicle, m.to_vehicle, m.range_m, m.sigma_m))
        self._inner.add(m)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """As the protocol says."""
        return self._inner.estimate(vehicle, at_s)

    def drain_residuals(self) -> list[Residual]:
        """As the protocol says."""
        return self._inner.drain_residuals()

    def counts(self) -> Mapping[str, int]:
        """As the protocol says."""
        return self._inner.counts()

    def findings(self, truth: Sequence[TruthPoint], frame: LocalFrame | None) -> list[DataFinding]:
        """The findings among positions, ranges and true positions, in the frame of the fleet."""
        if frame is None:
            return []
        data, elsewhere = self.recorded_data(truth, frame)
        return elsewhere + run_checks(data)

    def recorded_data(self, truth: Sequence[TruthPoint], frame: LocalFrame) -> tuple[RecordedData, list[DataFinding]]:
        """What the checks compare, and the findings of a truth that is elsewhere: that one is left out."""
        reports = {vehicle: position_track(np.array(rows).reshape(-1, 8)) for vehicle, rows in self._positions.items()}
        reports |= self._static
        places: dict[int, list[TruthPoint]] = defaultdict(list)
        for point in truth:
            places[point.sysid].append(point)
        true = {sysid: _enu(points, frame) for sysid, points in places.items() if sysid in reports}
        elsewhere = list(_elsewhere(true, places, frame))
        ranges = np.array(self._ranges).reshape(-1, 5)
        names = {vehicle: node_name(vehicle) for vehicle in {*reports, *true, *ranges[:, 1:3].astype(int).ravel().tolist()}}
        return RecordedData(names, reports, {} if elsewhere else true, ranges, origin_height_m=frame.height_m), elsewhere

    def _is_due(self, what: tuple[int, int], at_s: float, every_s: float) -> bool:
        if self._rows >= MAX_ROWS or at_s < self._next_s.get(what, float("-inf")):
            return False
        self._next_s[what] = at_s + every_s
        self._rows += 1
        return True


def _enu(points: Sequence[TruthPoint], frame: LocalFrame) -> PositionTrack:
    rows = [(p.unix_s, *frame.enu_from_geodetic(p.lat_deg, p.lon_deg, p.alt_msl_m), 0.0) for p in points]
    return position_track(np.array(rows))


def _elsewhere(
    true: Mapping[int, PositionTrack], places: Mapping[int, Sequence[TruthPoint]], frame: LocalFrame
) -> Iterator[DataFinding]:
    """Yield that the truth lies in another part of the world, once for all vehicles."""
    off_m = {sysid: _away_m(one.positions_enu_m) for sysid, one in true.items()}
    if not off_m or min(off_m.values()) < _ELSEWHERE_M:
        return
    sysid = next(iter(off_m))
    swapped = [frame.enu_from_geodetic(p.lon_deg, p.lat_deg, p.alt_msl_m) for p in places[sysid] if abs(p.lon_deg) <= 90.0]
    is_swapped = bool(swapped) and _away_m(np.array(swapped)) < _ELSEWHERE_M
    question = ": are latitude and longitude swapped?" if is_swapped else ""
    yield finding(FindingKind.TRUTH_ELSEWHERE, off_m[sysid], km=off_m[sysid] / 1000.0, question=question)


def _away_m(positions_enu_m: FloatArray) -> float:
    return float(np.median(np.linalg.norm(positions_enu_m, axis=1)))
