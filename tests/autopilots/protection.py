"""What a flight's fixes were stated with, as the service's recording replays it: 95 % bounds and protection levels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pilot import Place3D

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.outbound import GlobalPositionSensor, GpsInput, Outbound
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.tlog import TlogReader


@dataclass(frozen=True)
class BoundedFix:
    """The position of a message with a fix at its time of sending, with its horizontal 95 % bound and protection level, m."""

    place: Place3D
    bound_95_m: float
    hpl_m: float


def bounded_fixes(recording: Path, configuration: Path, sysid: int) -> list[BoundedFix]:
    """The GPS_INPUT with a fix, or GLOBAL_POSITION_SENSOR, to one vehicle."""
    settings = load_settings(configuration, {})
    engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
    out: list[BoundedFix] = []

    def polled(at_s: float, outputs: list[Outbound]) -> None:
        for sent in outputs:
            if not isinstance(sent, GpsInput | GlobalPositionSensor) or sent.sysid != sysid:
                continue
            if isinstance(sent, GpsInput) and sent.fix_type < 3:
                continue
            where = engine.estimate(sysid, at_s)
            assert isinstance(where, Estimate)
            assert where.protection is not None
            place = Place3D(at_s, sent.lat_deg, sent.lon_deg, sent.alt_msl_m)
            out.append(BoundedFix(place, horizontal_bound_95_m(where.covariance), where.protection.horizontal_m))

    own = (settings.mavlink.system_id, settings.mavlink.component_id)
    replay = Replay(engine, TlogReader(recording), [], polled, own, settings.fingerprint())
    while replay.next_s is not None:
        replay.step()
    return out
