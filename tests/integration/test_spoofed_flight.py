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
ENDED_S = 120.0
"""Since the step."""
FLOWN_S = ENDED_S + 19.0
"""So far the replay goes: GPS_PRIMARY of the recorded plane stayed with what 0.1 sent, and that is 9 m off a second later."""
SPOOFED, SOUND = 4, (1, 2, 3)


def test_the_stepped_receiver_is_named_and_healthy_soon_after_its_end_and_the_sound_planes_stay_healthy():
    flight = recording("arduplane-flights/spoof-step-200m/flight.tlog")
    engine = Engine(load_estimator("fleet", {}))
    through = Replay(engine, TlogReader(flight), [], lambda _at_s, _outputs: None)
    named_s = healthy_s = None
    while (through.next_s or inf) < STEPPED_UNIX_S + FLOWN_S:
        through.step()
        since_s = through.now_s - STEPPED_UNIX_S
        if since_s > 0.0:
            assert all(engine.gps_state(sysid) is GpsState.HEALTHY for sysid in SOUND)
        if named_s is None and engine.gps_state(SPOOFED) is GpsState.FAILED:
            named_s = since_s
        if since_s <= ENDED_S or engine.gps_state(SPOOFED) is not GpsState.HEALTHY:
            healthy_s = None
        elif healthy_s is None:
            healthy_s = since_s - ENDED_S
    assert named_s is not None
    # Its EKF reports a glitch after 1.4 s; then its receiver is tested by itself, while the autopilot still refuses the step.
    assert 0.0 < named_s <= 5.0
    assert healthy_s is not None
    # A loss that ends needs 10.5 s; the ranges test it for that long, too.
    assert 5.0 < healthy_s <= 15.0
