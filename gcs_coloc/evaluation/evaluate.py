"""Runs an estimator over a data set and scores it.

Causally: an estimate uses only what had arrived by its time.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    FloatArray,
    Measurement,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
    VehicleClassReport,
    count_reasons,
)
from gcs_coloc.evaluation.data_checks.checks import check_delays, run_checks
from gcs_coloc.evaluation.data_checks.findings import DataFinding, FindingKind, finding
from gcs_coloc.evaluation.data_checks.recorded_data import recorded_data
from gcs_coloc.evaluation.dataset import Dataset, Truth, read_dataset
from gcs_coloc.evaluation.dataset_meta import Node
from gcs_coloc.evaluation.scoring import EstimateSeries, VehicleScore, score, series_of

_PLANE_EVERY_S = 0.2  # chosen: as often as the service reviews a fleet
_PLANE_SIGMA_M = 0.1
"""Period and 1-sigma of the heights that a flat data set gives a denied vehicle. Chosen: a good barometer at 5 Hz."""
_KINDS = {PositionMeasurement: "positions", RangeMeasurement: "ranges", AltitudeMeasurement: "heights"}
_EPOCH_S = 0.2
"""Spacing of the epochs of a vehicle without truth. Chosen: as often as most data sets range."""
_PROGRESS_EVERY = 500  # chosen: several times a second


@dataclass(frozen=True, slots=True)
class VehicleEvaluation:
    """One denied vehicle: its score, the epochs behind it, and the NIS of its ranges.

    The NIS is (N, 2): time in s, normalised innovation squared.

    `unanswered`: how many epochs have no estimate, by the estimator's reason with the numbers of its first time.
    """

    node: Node
    score: VehicleScore
    series: EstimateSeries
    nis: FloatArray
    unanswered: Mapping[Unlocated, int]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, for JSON."""
        unanswered = {stated.reason.code: {"times": times, "text": stated.text} for stated, times in self.unanswered.items()}
        return asdict(self.score) | {"unanswered": unanswered}


@dataclass(frozen=True, slots=True)
class Evaluation:
    """An estimator's result on a data set.

    `cpu_us_per_measurement` includes the estimates at the epochs of the truth.

    `findings`: what the data checks found, if `evaluate` read the data.
    """

    dataset: str
    dims: int
    estimator: str
    measurements: int
    cpu_us_per_measurement: float
    denied: tuple[VehicleEvaluation, ...]
    counts: Mapping[str, int]
    findings: tuple[DataFinding, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, for JSON."""
        return {
            "version": version("gcs-coloc"),
            "dataset": self.dataset,
            "dims": self.dims,
            "estimator": self.estimator,
            "measurements": self.measurements,
            "cpu_us_per_measurement": self.cpu_us_per_measurement,
            "denied": {vehicle.node.id: vehicle.as_dict() for vehicle in self.denied},
            "counts": dict(self.counts),
            "warnings": [asdict(finding) for finding in self.findings],
        }


Progress = Callable[[int, int], None]
"""Called with how many of how many measurements are done."""


def evaluate(
    directory: Path,
    estimator: Estimator,
    cpu_s: Callable[[], float] = time.process_time,
    progress: Progress = lambda _done, _total: None,
) -> Evaluation:
    """Read the data set in `directory`, run `estimator` over it and score it.

    A node with the role "denied" becomes a denied vehicle at its last position report, and is scored from then on; one without
    reports is one from the start. Without `truth.csv` it is located all the same, five times a second, and there is no error.

    Raises:
        DataError: the data set cannot be read.

    """
    dataset = read_dataset(directory)
    return replace(evaluate_dataset(dataset, estimator, cpu_s, progress), findings=tuple(dataset_findings(dataset)))


def dataset_findings(dataset: Dataset) -> list[DataFinding]:
    """Return what was dropped of a data set, and what does not agree in it.

    Units, axes, clocks, offsets, repeated ranges.
    """
    dropped = [
        finding(FindingKind.DROPPED_ROWS, one.count, one.path.name, rows=one.rows, first="; ".join(one.first))
        for one in dataset.dropped
    ]
    delays_s: dict[str, list[float]] = defaultdict(list)
    for m in dataset.measurements:
        if type(m) in _KINDS:
            delays_s[_KINDS[type(m)]].append(m.arrived_at_s - m.measured_at_s)
    return [
        *dropped,
        *check_delays({kind: np.array(found) for kind, found in delays_s.items()}),
        *run_checks(recorded_data(dataset)),
    ]


def evaluate_dataset(
    dataset: Dataset,
    estimator: Estimator,
    cpu_s: Callable[[], float] = time.process_time,
    progress: Progress = lambda _done, _total: None,
) -> Evaluation:
    """Run an estimator over a data set that is in memory and score it.

    `cpu_s` returns the CPU time spent so far.
    """
    measurements = _measurements_in_order(dataset)
    start_s = measurements[0].arrived_at_s
    last_report_s = {node.vehicle: _last_report_s(dataset, node.vehicle) for node in dataset.denied()}
    since_s = {vehicle: max(t, start_s) for vehicle, t in last_report_s.items()}
    end_s = measurements[-1].arrived_at_s
    wanted = {
        node.vehicle: dataset.truth[node.vehicle] if dataset.truth else _epochs(since_s[node.vehicle], end_s)
        for node in dataset.denied()
        if node.vehicle in dataset.truth or not dataset.truth
    }
    answers: dict[int, list[Estimate | NoEstimate]] = {vehicle: [] for vehicle in wanted}
    nis: dict[int, list[tuple[float, float]]] = {vehicle: [] for vehicle in since_s}
    queries = sorted((t, vehicle) for vehicle, truth in wanted.items() for t in truth.times_s.tolist() if t >= since_s[vehicle])
    denied: frozenset[int] = frozenset()
    next_query = 0
    began_s = cpu_s()

    def answer_queries_before(at_s: float) -> None:
        nonlocal next_query
        while next_query < len(queries) and queries[next_query][0] < at_s:
            t, vehicle = queries[next_query]
            # A plug-in may go on to change the arrays that it gave.
            answers[vehicle].append(deepcopy(estimator.estimate(vehicle, t)))
            next_query += 1

    for node in dataset.nodes:
        if node.vehicle_class is not None:
            estimator.add(VehicleClassReport(node.vehicle, start_s, start_s, node.vehicle_class))
    for done, m in enumerate(measurements):
        if done % _PROGRESS_EVERY == 0:
            progress(done, len(measurements))
        answer_queries_before(m.arrived_at_s)
        failed = frozenset(vehicle for vehicle, t in last_report_s.items() if t < m.arrived_at_s)
        if failed != denied:
            denied = failed
            estimator.set_denied(denied, m.arrived_at_s)
        estimator.add(m)
        if isinstance(m, RangeMeasurement):
            for residual in estimator.drain_residuals():
                for end in (residual.from_vehicle, residual.to_vehicle):
                    if end in nis and end is not None:
                        nis[end].append((residual.measured_at_s, residual.nis / residual.degrees_of_freedom))
    answer_queries_before(math.inf)
    progress(len(measurements), len(measurements))
    spent_s = cpu_s() - began_s
    evaluated = []
    for node in dataset.denied():
        if node.vehicle not in wanted:
            continue
        truth = wanted[node.vehicle]
        scored = truth.times_s >= since_s[node.vehicle]
        of_vehicle = answers[node.vehicle]
        known = [answer if isinstance(answer, Estimate) else None for answer in of_vehicle]
        unanswered = count_reasons(answer.reason for answer in of_vehicle if isinstance(answer, NoEstimate))
        series = series_of(truth.times_s[scored], truth.positions_enu_m[scored], known)
        history = np.array(nis[node.vehicle]).reshape(-1, 2)
        evaluated.append(VehicleEvaluation(node, score(series, since_s[node.vehicle], dataset.dims), series, history, unanswered))
    count = len(dataset.measurements)
    return Evaluation(
        dataset=dataset.name,
        dims=dataset.dims,
        estimator=estimator.name,
        measurements=count,
        cpu_us_per_measurement=spent_s / count * 1e6,
        denied=tuple(evaluated),
        counts=estimator.counts(),
    )


def _epochs(since_s: float, end_s: float) -> Truth:
    """Return the epochs of a vehicle without truth."""
    times_s = np.arange(since_s, end_s + _EPOCH_S, _EPOCH_S)
    return Truth(times_s, np.full((len(times_s), 3), np.nan))


def _measurements_in_order(dataset: Dataset) -> list[Measurement]:
    """Return what the estimator is given, in order of arrival.

    Anchors come first, and in two dimensions the height of the plane.
    """
    first_s = min(m.measured_at_s for m in dataset.measurements)
    anchors: list[Measurement] = [
        PositionMeasurement(node.vehicle, first_s, first_s, node.place_enu_m, node.sigma_m, node.sigma_m, static=True)
        for node in dataset.nodes
        if node.place_enu_m is not None and node.sigma_m is not None
    ]
    moving = list(dataset.measurements)
    if dataset.dims == 2:
        moving.extend(_plane(dataset))
        moving.sort(key=lambda m: m.arrived_at_s)
    return anchors + moving


def _plane(dataset: Dataset) -> Iterator[Measurement]:
    """Yield heights for the vehicles of a flat data set.

    That all nodes move in one plane is knowledge like a barometer's.
    """
    places = [node.place_enu_m[2] for node in dataset.nodes if node.place_enu_m is not None]
    reports = [m.position_enu_m[2] for m in dataset.measurements if isinstance(m, PositionMeasurement)]
    plane_m = float(np.median(places + reports)) if places or reports else 0.0
    for node in dataset.denied():
        last_s = -math.inf
        for m in dataset.measurements:
            if m.arrived_at_s - last_s >= _PLANE_EVERY_S:
                last_s = m.arrived_at_s
                yield AltitudeMeasurement(node.vehicle, m.arrived_at_s, m.arrived_at_s, plane_m, _PLANE_SIGMA_M)


def _last_report_s(dataset: Dataset, vehicle: int) -> float:
    reports = [m.arrived_at_s for m in dataset.measurements if isinstance(m, PositionMeasurement) and m.vehicle == vehicle]
    return max(reports, default=-math.inf)
