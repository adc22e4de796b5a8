"""What the engine states of recorded flights of real autopilots."""

from __future__ import annotations

import pytest

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import HealthChanged, Notice, Outbound
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.tlog import TlogReader
from tests.recordings import recording


def stated(name: str, to_s: float) -> list[tuple[float, HealthChanged | Notice]]:
    """Replay the beginning of a recording; return what people are shown, with the time in the recording."""
    out: list[tuple[float, HealthChanged | Notice]] = []
    engine = Engine(load_estimator("fleet", {}))

    def polled(at_s: float, outputs: list[Outbound]) -> None:
        out.extend((at_s - start_s, output) for output in outputs if isinstance(output, HealthChanged | Notice))

    flight = Replay(engine, TlogReader(recording(name)), [], polled)
    start_s = flight.next_s or 0.0
    while (at_s := flight.next_s) is not None and at_s <= start_s + to_s:
        flight.step()
    return out


@pytest.fixture(scope="module")
def px4_shown() -> list[tuple[float, HealthChanged | Notice]]:
    """The first 75 s of four PX4."""
    return stated("px4-flight/flight.tlog", 75.0)


def test_px4_at_rest_on_the_ground_is_healthy(px4_shown):
    """It states a constant position beside an absolute one there."""
    changes = [shown for at_s, shown in px4_shown if isinstance(shown, HealthChanged) and at_s <= 30.0]
    assert {(change.sysid, change.after) for change in changes} == {(sysid, "healthy") for sysid in (1, 2, 3, 4)}


def test_the_clock_of_a_simulation_that_runs_unevenly_is_no_reboot(px4_shown):
    """Up to 4 % fast and slow, and it stands still for 0.3 to 0.8 s. It answers TIMESYNC all the while."""
    texts = [shown.text for _, shown in px4_shown if isinstance(shown, Notice)]
    assert [text for text in texts if "clock jumped" in text or "TIMESYNC" in text] == []


def test_jamming_is_one_loss_and_one_recovery():
    """The receiver's fix flickers between none and 3D several times a second for three minutes."""
    shown = stated("arduplane-flights/jam/flight.tlog", 205.0)
    changes = [output.after for _, output in shown if isinstance(output, HealthChanged) and output.sysid == 4]
    assert changes == ["healthy", "suspect", "failed", "recovering", "healthy"]
    assert len(shown) <= 30
