"""Four real ArduPlanes in flight, recorded: the receiver of vehicle 4 steps by 200 m, and its ranges are the only ones."""

from __future__ import annotations

from math import inf

import pytest
from recordings import recording

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.tlog import TlogReader

pytestmark = pytest.mark.integration

STEPPED_UNIX_S = 1795313676.72
SPOOFED, SOUND = 4, (1, 2, 3)


def test_the_stepped_receiver_is_named_and_the_sound_planes_stay_healthy():
    flight = recording("arduplane-flights/spoof-step-200m/flight.tlog")
    engine = Engine(load_estimator("fleet", {}))
    through = Replay(engine, TlogReader(flight), [], lambda _at_s, _outputs: None)
    named_s = None
    while (through.next_s or inf) < STEPPED_UNIX_S + 20.0:
        through.step()
        since_s = through.now_s - STEPPED_UNIX_S
        if since_s > 0.0:
            assert all(engine.gps_state(sysid) is GpsState.HEALTHY for sysid in SOUND)
        if named_s is None and engine.gps_state(SPOOFED) is GpsState.FAILED:
            named_s = since_s
    assert named_s is not None
    # Its EKF reports a glitch after 1.4 s; then its receiver is tested by itself, while the autopilot still refuses the step.
    assert 0.0 < named_s <= 5.0
