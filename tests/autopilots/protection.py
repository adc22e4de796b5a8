"""Protection levels of a flight: what each fix was sent with, as the service's recording replays it."""

from __future__ import annotations

from pathlib import Path

from pilot import Place3D

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.outbound import GpsInput, Outbound
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.tlog import TlogReader


def fixes_with_level(recording: Path, configuration: Path, sysid: int) -> list[tuple[Place3D, float]]:
    """Positions of the GPS_INPUT with a fix to one vehicle, at their times of sending, and their horizontal levels in m."""
    settings = load_settings(configuration, {})
    engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
    out: list[tuple[Place3D, float]] = []

    def polled(at_s: float, outputs: list[Outbound]) -> None:
        for sent in outputs:
            if isinstance(sent, GpsInput) and sent.sysid == sysid and sent.fix_type >= 3:
                where = engine.estimate(sysid, at_s)
                assert isinstance(where, Estimate)
                assert where.protection is not None
                out.append((Place3D(at_s, sent.lat_deg, sent.lon_deg, sent.alt_msl_m), where.protection.horizontal_m))

    own = (settings.mavlink.system_id, settings.mavlink.component_id)
    replay = Replay(engine, TlogReader(recording), [], polled, own, settings.fingerprint())
    while replay.next_s is not None:
        replay.step()
    return out
