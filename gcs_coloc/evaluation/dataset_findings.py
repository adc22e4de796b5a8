"""The data checks of a data set."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from gcs_coloc.core.measurements import AltitudeMeasurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.evaluation.data_checks.checks import check_delays, run_checks
from gcs_coloc.evaluation.data_checks.findings import DataFinding
from gcs_coloc.evaluation.data_checks.recorded_data import PositionTrack, RecordedData, position_track
from gcs_coloc.evaluation.dataset import Dataset

_NO_VELOCITY = (float("nan"),) * 3
_KINDS = {PositionMeasurement: "positions", RangeMeasurement: "ranges", AltitudeMeasurement: "heights"}


def dataset_findings(dataset: Dataset) -> list[DataFinding]:
    """Return what does not agree in a data set: units, axes, clocks, offsets, repeated ranges."""
    delays: dict[str, list[float]] = defaultdict(list)
    positions: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    heights: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    ranges: list[tuple[float, ...]] = []
    # In a flat data set the heights say nothing of the distances.
    height = 1.0 if dataset.dims == 3 else 0.0
    for m in dataset.measurements:
        if type(m) in _KINDS:
            delays[_KINDS[type(m)]].append(m.arrived_at_s - m.measured_at_s)
        if isinstance(m, PositionMeasurement):
            e, n, u = m.position_enu_m
            row = (m.measured_at_s, e, n, height * u, m.sigma_h_m, *(m.velocity_enu_mps or _NO_VELOCITY))
            positions[m.vehicle].append(row)
        elif isinstance(m, RangeMeasurement):
            ranges.append((m.measured_at_s, m.from_vehicle, m.to_vehicle, m.range_m, m.sigma_m))
        elif isinstance(m, AltitudeMeasurement) and dataset.dims == 3:
            heights[m.vehicle].append((m.measured_at_s, m.up_m, m.sigma_m))
    reports = {vehicle: position_track(np.array(rows)) for vehicle, rows in positions.items()}
    for node in dataset.nodes:
        if node.place_enu_m is not None and node.sigma_m is not None:
            place = np.array([node.place_enu_m]) * (1.0, 1.0, height)
            reports[node.vehicle] = PositionTrack(np.zeros(1), place, np.array([node.sigma_m]), is_static=True)
    data = RecordedData(
        names={node.vehicle: node.id for node in dataset.nodes},
        reports=reports,
        truth={
            vehicle: PositionTrack(true.times_s, true.positions_enu_m * (1.0, 1.0, height), np.zeros(len(true.times_s)))
            for vehicle, true in dataset.truth.items()
        },
        ranges=np.array(ranges, dtype=float).reshape(-1, 5),
        heights={vehicle: np.array(rows) for vehicle, rows in heights.items()},
    )
    return [*check_delays({kind: np.array(found) for kind, found in delays.items()}), *run_checks(data)]
