"""Runs an estimator over a data set and scores it: causally, so an estimate uses only what had arrived by its time."""

from __future__ import annotations

import math
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gcs_coloc import __version__
from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    FloatArray,
    Measurement,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.evaluation.data_checks.checks import check_delays, run_checks
from gcs_coloc.evaluation.data_checks.findings import DataFinding
from gcs_coloc.evaluation.data_checks.recorded_data import recorded_data
from gcs_coloc.evaluation.dataset import Dataset, Node, read_dataset
from gcs_coloc.evaluation.scoring import EstimateSeries, VehicleScore, score, series_of

_PLANE_EVERY_S = 0.2
_PLANE_SIGMA_M = 0.1
"""Period and 1-sigma of the heights that a flat data set gives a denied vehicle. Chosen: a good barometer at 5 Hz."""
_KINDS = {PositionMeasurement: "positions", RangeMeasurement: "ranges", AltitudeMeasurement: "heights"}
_NUMBER = re.compile(r"[0-9.]+")


@dataclass(frozen=True, slots=True)
class VehicleEvaluation:
    """One denied vehicle: its score, the epochs behind it, and the normalised innovations (N, 2) of its ranges: time in s, NIS.

    `unanswered`: how many epochs have no estimate, by the estimator's reason as it was first given, whatever numbers are in it.
    """

    node: Node
    score: VehicleScore
    series: EstimateSeries
    nis: FloatArray
    unanswered: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """An estimator's result on a data set; `cpu_us_per_measurement` includes the estimates at the epochs of the truth.

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
            "version": __version__,
            "dataset": self.dataset,
            "dims": self.dims,
            "estimator": self.estimator,
            "measurements": self.measurements,
            "cpu_us_per_measurement": self.cpu_us_per_measurement,
            "denied": {s.node.id: asdict(s.score) | {"unanswered": dict(s.unanswered)} for s in self.denied},
            "counts": dict(self.counts),
            "warnings": [finding.as_dict() for finding in self.findings],
        }


def evaluate(directory: Path, estimator: Estimator, cpu_s: Callable[[], float] = time.process_time) -> Evaluation:
    """Read the data set in `directory`, run `estimator` over it and score it.

    A node with the role "denied" becomes a denied vehicle at its last position report, and is scored from then on; one without
    reports is one from the start.

    Raises:
        DataError: the data set cannot be read.

    """
    dataset = read_dataset(directory)
    return replace(evaluate_dataset(dataset, estimator, cpu_s), findings=tuple(dataset_findings(dataset)))


def dataset_findings(dataset: Dataset) -> list[DataFinding]:
    """Return what does not agree in a data set: units, axes, clocks, offsets, repeated ranges."""
    delays_s: dict[str, list[float]] = defaultdict(list)
    for m in dataset.measurements:
        if type(m) in _KINDS:
            delays_s[_KINDS[type(m)]].append(m.arrived_at_s - m.measured_at_s)
    return [*check_delays({kind: np.array(found) for kind, found in delays_s.items()}), *run_checks(recorded_data(dataset))]


def evaluate_dataset(dataset: Dataset, estimator: Estimator, cpu_s: Callable[[], float] = time.process_time) -> Evaluation:
    """Run an estimator over a data set that is in memory and score it. `cpu_s` returns the CPU time spent so far."""
    measurements = _measurements_in_order(dataset)
    start_s = measurements[0].arrived_at_s
    last_report_s = {node.vehicle: _last_report_s(dataset, node.vehicle) for node in dataset.denied()}
    since_s = {vehicle: max(t, start_s) for vehicle, t in last_report_s.items()}
    wanted = {node.vehicle: dataset.truth[node.vehicle] for node in dataset.denied() if node.vehicle in dataset.truth}
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
            answers[vehicle].append(estimator.estimate(vehicle, t))
            next_query += 1

    for m in measurements:
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
    spent_s = cpu_s() - began_s
    evaluated = []
    for node in dataset.denied():
        if node.vehicle not in wanted:
            continue
        truth = wanted[node.vehicle]
        scored = truth.times_s >= since_s[node.vehicle]
        of_vehicle = answers[node.vehicle]
        known = [answer if isinstance(answer, Estimate) else None for answer in of_vehicle]
        unanswered = _by_reason(answer.reason for answer in of_vehicle if isinstance(answer, NoEstimate))
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


def _by_reason(reasons: Iterable[str]) -> dict[str, int]:
    first: dict[str, str] = {}
    times: Counter[str] = Counter(first.setdefault(_NUMBER.sub("", reason), reason) for reason in reasons)
    return dict(times.most_common())


def _measurements_in_order(dataset: Dataset) -> list[Measurement]:
    """Return what the estimator is given, in order of arrival: anchors first, and in two dimensions the height of the plane."""
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
    """Yield heights for the vehicles of a flat data set: that all nodes move in one plane is knowledge like a barometer's."""
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


def plot_evaluation(evaluation: Evaluation, path: Path) -> None:
    """Draw each vehicle's track, its error against the stated 2-sigma, and the NIS of its ranges; the ending sets the format.

    Raises:
        UsageError: matplotlib is not installed, or the ending is not one that it writes, or the file cannot be written.

    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError('drawing needs matplotlib: pip install "gcs-coloc[plots]"') from error
    figure = Figure(figsize=(12.0, 6.0 * len(evaluation.denied)), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{evaluation.dataset}: {evaluation.estimator}")
    rows = figure.subplots(2 * len(evaluation.denied), 2, squeeze=False)
    for i, denied_vehicle in enumerate(evaluation.denied):
        grid = rows[0, 0].get_gridspec()
        for axes in rows[2 * i : 2 * i + 2, 0]:
            axes.remove()
        track = figure.add_subplot(grid[2 * i : 2 * i + 2, 0])
        _draw(denied_vehicle, track, rows[2 * i, 1], rows[2 * i + 1, 1])
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def _draw(denied_vehicle: VehicleEvaluation, track: Any, error: Any, nis: Any) -> None:
    series = denied_vehicle.series
    t = series.times_s
    track.plot(series.truth_enu_m[:, 0], series.truth_enu_m[:, 1], color="0.6", lw=3, label="truth")
    track.plot(series.estimate_enu_m[:, 0], series.estimate_enu_m[:, 1], color="#0072b2", lw=1, label="estimate")
    track.set(xlabel="east, m", ylabel="north, m", title=denied_vehicle.node.id, aspect="equal")
    track.legend()
    horizontal_m = np.linalg.norm((series.estimate_enu_m - series.truth_enu_m)[:, :2], axis=1)
    two_sigma_m = 2.0 * np.sqrt(0.5 * (series.covariance_m2[:, 0, 0] + series.covariance_m2[:, 1, 1]))
    error.plot(t, horizontal_m, color="#0072b2", lw=1, label="horizontal error")
    error.plot(t, two_sigma_m, color="#d55e00", lw=1, label="2 sigma, mean of both axes")
    error.set(ylabel="m", ylim=(0.0, None))
    error.legend()
    nis.plot(denied_vehicle.nis[:, 0], denied_vehicle.nis[:, 1], ".", color="0.4", ms=2)
    nis.axhline(1.0, color="#d55e00", lw=1)
    nis.set(xlabel="s", ylabel="NIS of ranges (1 on average)", yscale="symlog")
