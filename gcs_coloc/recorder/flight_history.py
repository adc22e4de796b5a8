"""The history of a recorded flight, replayed through the engine.

For export and report, and as arrays for notebooks.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import DISTRUSTED
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.core.messages.outbound import HealthChanged, Notice, Outbound
from gcs_coloc.core.schedule import SAME_S
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.evaluation.data_checks.findings import DataFinding
from gcs_coloc.evaluation.data_checks.recorded_data import RecordedData
from gcs_coloc.recorder.flight_report import FlightReport, MeasurementTap
from gcs_coloc.recorder.journal import Journal, RangeEntry, StationEntry, VehicleEntry
from gcs_coloc.recorder.replay import Replay, ReplayCounts, replay
from gcs_coloc.recorder.side_tables import read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader

WITHOUT_GPS = tuple(state.value for state in DISTRUSTED)
"""The GPS states in which a vehicle is located by its ranges."""


@dataclass(slots=True)
class FlightHistory:
    """The history of one flight.

    `tracks`: each vehicle's entries in order of time. `stations`: the fixed ones as last known, by node id. `damage`: what of the
    file could not be read. `frame`: the fleet's, about its first fix; None where there was none. `findings`: data-quality
    findings in the recording and the tables beside it. `recorded`: what they compare; None without a frame.
    """

    file: Path
    estimator: str
    counts: ReplayCounts
    report: FlightReport
    damage: Mapping[str, int]
    tracks: Mapping[int, list[VehicleEntry]] = field(default_factory=dict)
    ranges: list[RangeEntry] = field(default_factory=list)
    stations: dict[int, StationSnapshot] = field(default_factory=dict)
    health: list[HealthChanged] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)
    frame: LocalFrame | None = None
    findings: list[DataFinding] = field(default_factory=list)
    recorded: RecordedData | None = None


def read_history(
    file: Path,
    settings: Settings,
    ranges: Path | None,
    truth: Path | None,
    on_snapshot: Callable[[FleetSnapshot], None] | None = None,
) -> FlightHistory:
    """Replay a recording and collect its history.

    Args:
        file: the tlog.
        settings: those of the flight, or others.
        ranges: a table of ranges beside the recording, or None.
        truth: a table of true positions, or None.
        on_snapshot: called with the fleet at each deadline of the engine, at most as often as positions are sent.

    Raises:
        DataError: a file cannot be read or is not what it should be.
        EstimatorError: the estimator cannot be loaded.
    """
    tap = MeasurementTap(load_estimator(settings.estimator.name, settings.estimator.settings))
    engine = Engine(tap, settings.engine())
    log, journal = TlogReader(file), Journal(engine)
    points = read_truth(truth)
    report = FlightReport(engine, points)
    tracks: dict[int, list[VehicleEntry]] = defaultdict(list)
    history = FlightHistory(file, engine.estimator.name, ReplayCounts(), report, log.counts, tracks)

    due_s = float("-inf")

    def on_poll(at_s: float, outputs: list[Outbound]) -> None:
        nonlocal due_s
        report.add_outputs(at_s, outputs)
        if on_snapshot is not None and at_s >= due_s:
            due_s = at_s + 1.0 / settings.aiding.rate_hz - SAME_S
            on_snapshot(engine.snapshot(at_s))
        for entry in journal.entries(at_s, outputs):
            if isinstance(entry, VehicleEntry):
                tracks[entry.vehicle.sysid].append(entry)
            elif isinstance(entry, RangeEntry):
                history.ranges.append(entry)
            elif isinstance(entry, StationEntry):
                history.stations[entry.station.node] = entry.station
            elif isinstance(entry, HealthChanged):
                history.health.append(entry)
            elif isinstance(entry, Notice):
                history.notices.append(entry)

    through = Replay(engine, log, read_ranges(ranges), on_poll, settings.mavlink.own, settings.fingerprint())
    history.counts = replay(through, report.observation_times(), report.observe)
    history.frame = engine.frame
    history.findings = tap.findings(points, engine.frame)
    if engine.frame is not None:
        history.recorded, _ = tap.recorded_data(points, engine.frame)
    return history


@dataclass(frozen=True, slots=True)
class VehicleArrays:
    """One vehicle of a recording, a row each 0.4 s; NaN where a value is unknown."""

    unix_s: FloatArray
    """(T,) time, s since 1970."""
    lat_deg: FloatArray
    """(T,) WGS 84 latitude of the estimate, degrees."""
    lon_deg: FloatArray
    """(T,) WGS 84 longitude of the estimate, degrees."""
    alt_msl_m: FloatArray
    """(T,) height of the estimate above mean sea level, m."""
    enu_m: FloatArray
    """(T, 3) the estimate east, north and up of `RecordingArrays.origin`, m."""
    velocity_enu_mps: FloatArray
    """(T, 3) its velocity east, north and up, m/s."""
    covariance_h_m2: FloatArray
    """(T, 2, 2) covariance of its east and north, m^2."""
    bound_95_m: FloatArray
    """(T,) stated horizontal 95 % bound of its error, m."""
    reported_enu_m: FloatArray
    """(T, 3) the position that the vehicle itself reports, in the same frame, m."""
    gps_state: NDArray[np.str_]
    """(T,) state of its GPS in the service's words, as `healthy` or `failed`."""


@dataclass(frozen=True, slots=True)
class RecordingArrays:
    """A recorded flight: its vehicles by system id, and what the estimator made of each range."""

    vehicles: Mapping[int, VehicleArrays]
    residuals: FloatArray
    """(N, 6) by time: time of measurement in UNIX s, the two system ids, residual m, its sigma m, 1 if used else 0."""
    origin: tuple[float, float, float] | None
    """Latitude deg, longitude deg and altitude m of the frame's origin; None where no vehicle had a position."""


def read_recording(
    path: Path | str, estimator: str = "fleet", settings: Mapping[str, Any] | None = None, ranges: Path | str | None = None
) -> RecordingArrays:
    """Replay a recording (tlog) and return what the service knew of each vehicle, as arrays.

    Args:
        path: the tlog.
        estimator: its name, as in the configuration.
        settings: the estimator's settings by name; defaults for those left out.
        ranges: a table of ranges beside the recording, where it holds none.

    Raises:
        DataError: a file cannot be read, or is no recording.
        EstimatorError: the estimator cannot be loaded, or refuses a setting.

    """
    chosen = load_settings(None, {"estimator": {"name": estimator, "settings": dict(settings or {})}})
    history = read_history(Path(path), chosen, Path(ranges) if ranges is not None else None, None)
    residuals = [
        (e.at_s - e.range.age_s, e.range.from_sysid, e.range.to_sysid, e.range.innovation_m, e.range.sigma_m, not e.range.refused)
        for e in history.ranges
    ]
    rows = np.array(residuals, dtype=float).reshape(-1, 6)
    return RecordingArrays(
        vehicles={sysid: _vehicle_arrays(entries) for sysid, entries in sorted(history.tracks.items())},
        residuals=rows[np.argsort(rows[:, 0], kind="stable")],
        origin=_origin(history.frame),
    )


def _origin(frame: LocalFrame | None) -> tuple[float, float, float] | None:
    return (frame.lat_deg, frame.lon_deg, frame.height_m) if frame is not None else None


def _vehicle_arrays(entries: Sequence[VehicleEntry]) -> VehicleArrays:
    def column(value: Callable[[VehicleSnapshot], Any], *shape: int) -> FloatArray:
        unknown = np.full(shape, np.nan)
        return np.array([unknown if (x := value(one.vehicle)) is None else x for one in entries], dtype=float)

    return VehicleArrays(
        unix_s=np.array([one.at_s for one in entries]),
        lat_deg=column(lambda v: v.lat_deg),
        lon_deg=column(lambda v: v.lon_deg),
        alt_msl_m=column(lambda v: v.alt_msl_m),
        enu_m=column(lambda v: v.enu_m, 3),
        velocity_enu_mps=column(lambda v: v.velocity_enu_mps, 3),
        covariance_h_m2=column(lambda v: _matrix(v.covariance_h_m2), 2, 2),
        bound_95_m=column(lambda v: v.bound_95_m),
        reported_enu_m=column(lambda v: v.reported_enu_m, 3),
        gps_state=np.array([str(one.vehicle.gps_state) for one in entries]),
    )


def _matrix(moments: tuple[float, float, float] | None) -> FloatArray | None:
    """Return the covariance (2, 2) of its three distinct moments: east east, east north, north north."""
    return np.array([[moments[0], moments[1]], [moments[1], moments[2]]]) if moments is not None else None
