"""What it costs to compute a replay's pictures ahead, to keep them, and to go to any position of the flight."""

from __future__ import annotations

import random
import statistics
import struct
import tempfile
import time
from pathlib import Path

from bench.figures import Figure
from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.web.picture_store import PictureStore
from gcs_coloc.web.playback import OnPoll, Playback, ReplayPass
from gcs_coloc.web.wire import PlaybackCommand
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import SCENARIOS, load_scenario

_SCENARIO = SCENARIOS / "uwb.toml"
_EPOCH_S = 1.78e9
_MAX_SEEK_S = 0.05
"""Chosen: within one picture period of the page (0.2 s) on a machine four times as slow."""
_MAX_PASS_RATIO = 2.0
"""Chosen: a pass that takes twice a plain replay still is some twenty times as fast as the flight."""


def measure(quick: bool) -> list[Figure]:
    """CPU seconds of a plain replay, of the pass that computes the pictures, and of seeks among them."""
    flight_s, seeks = (120.0, 50) if quick else (900.0, 200)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "flight.tlog"
        _write(path, flight_s)
        began_s = time.process_time()
        replay(_replay(path, lambda *_: None))
        plain_s = time.process_time() - began_s
        store = PictureStore(*TlogReader(path).span())
        began_s = time.process_time()
        ReplayPass(lambda on_poll: _replay(path, on_poll), lambda _: {}, store).run()
        pass_s = time.process_time() - began_s
        playback, rng = Playback(store, 1.0), random.Random(5)
        seek_s = [_seek(playback, rng.uniform(store.first_s, store.last_s)) for _ in range(seeks)]
    return [
        Figure(
            f"to a computed position in a flight of {flight_s / 60:.0f} min, picture, events and tracks, CPU",
            f"mean {statistics.fmean(seek_s) * 1e3:.1f} ms, most {max(seek_s) * 1e3:.1f} ms",
            f"most <= {_MAX_SEEK_S * 1e3:.0f} ms",
            max(seek_s) <= _MAX_SEEK_S,
        ),
        Figure(
            "the pass that computes the pictures, CPU of a plain replay",
            f"{pass_s / plain_s:.2f} x ({pass_s:.1f} s; {len(store)} pictures, {store.size_bytes / 1e6:.1f} MB)",
            f"<= {_MAX_PASS_RATIO:.1f} x",
            pass_s <= _MAX_PASS_RATIO * plain_s,
        ),
    ]


def _write(path: Path, flight_s: float) -> None:
    fleet = Fleet(load_scenario(_SCENARIO), seed=3, unix_epoch_s=_EPOCH_S)
    with path.open("wb") as file:
        for step in range(1, round(flight_s * 50) + 1):
            for datagram in fleet.advance(step * 0.02):
                file.write(struct.pack(">Q", round((_EPOCH_S + datagram.due_s) * 1e6)) + datagram.payload)


def _replay(path: Path, on_poll: OnPoll) -> Replay:
    return Replay(Engine(load_estimator("fleet", {})), TlogReader(path), [], on_poll)


def _seek(playback: Playback, at_s: float) -> float:
    """The CPU seconds of everything that a page is sent at another position."""
    began_s = time.process_time()
    playback.apply_command(PlaybackCommand(playing=False, seek_s=at_s))
    playback.messages(with_counts=True)
    playback.events_after(0)
    playback.tracks()
    return time.process_time() - began_s
