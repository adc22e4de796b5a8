"""The history of a recorded flight, replayed through the engine, for export, report and notebooks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED
from gcs_coloc.core.messages.outbound import HealthChanged, Notice, Outbound
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.evaluation.data_checks.findings import DataFinding
from gcs_coloc.recorder.journal import Journal, RangeEntry, VehicleEntry
from gcs_coloc.recorder.recorded_messages import ReplayCounts
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.reports.flight_findings import MeasurementTap
from gcs_coloc.recorder.reports.flight_report import FlightReport
from gcs_coloc.recorder.side_tables import read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader

WITHOUT_GPS = tuple(state.value for state in DISTRUSTED)
"""The GPS states in which a vehicle is located by its ranges."""


@dataclass(slots=True)
class FlightHistory:
    """The history of one flight.

    `tracks`: each vehicle's entries in order of time. `damage`: what of the file could not be read. `frame`: the fleet's, about
    its first fix; None where there was none. `findings`: data-quality findings in the recording and the tables beside it.
    """

    file: Path
    estimator: str
    counts: ReplayCounts
    report: FlightReport
    damage: Mapping[str, int]
    tracks: Mapping[int, list[VehicleEntry]] = field(default_factory=dict)
    ranges: list[RangeEntry] = field(default_factory=list)
    health: list[HealthChanged] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    frame: LocalFrame | None = None
    findings: list[DataFinding] = field(default_factory=list)


def read_history(file: Path, settings: Settings, ranges: Path | None, truth: Path | None) -> FlightHistory:
    """Replay a recording and collect its history.

    Args:
        file: the tlog.
        settings: those of the flight, or others.
        ranges: a table of ranges beside the recording, or None.
        truth: a table of true positions, or None.

    Raises:
        DataError: a file cannot be read or is not what it should be.
        EstimatorError: the estimator cannot be loaded.
    """
    tap = MeasurementTap(load_estimator(settings.estimator.name, settings.estimator.settings))
    engine = Engine(tap, settings.engine())
    log, journal = TlogReader(file), Journal(engine)
    points = read_truth(truth) if truth is not None else []
    report = FlightReport(engine, points)
    tracks: dict[int, list[VehicleEntry]] = defaultdict(list)
    history = FlightHistory(file, engine.estimator.name, ReplayCounts(), report, log.counts, tracks)

    def on_poll(at_s: float, outputs: list[Outbound]) -> None:
        report.add_outputs(at_s, outputs)
        for entry in journal.entries(at_s, outputs):
            if isinstance(entry, VehicleEntry):
                tracks[entry.vehicle.sysid].append(entry)
            elif isinstance(entry, RangeEntry):
                history.ranges.append(entry)
            elif isinstance(entry, HealthChanged):
                history.health.append(entry)
            else:
                history.notices.append(entry)

    own = (settings.mavlink.system_id, settings.mavlink.component_id)
    table_ranges = read_ranges(ranges) if ranges is not None else []
    through = Replay(engine, log, table_ranges, on_poll, own, settings.fingerprint())
    history.counts = replay(through, report.observation_times(), report.observe)
    history.frame = engine.frame
    history.findings = tap.findings(points, engine.frame)
    return history
