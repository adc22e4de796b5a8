"""Jumping about in a replay on the page: what a place costs from the states that were kept, and from the beginning."""

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
from gcs_coloc.recorder.checkpoints import Checkpoints
from gcs_coloc.recorder.playhead import Playhead
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.web.playback import OnPoll, Playback
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import PlaybackCommand
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import load_scenario

_SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "scenario-uwb.toml"
_EPOCH_S = 1.78e9
_MOST_MEAN_S = 1.0
_MOST_SHARE = 0.05


class _Costed(Checkpoints):
    """Knows how long it took to make what it keeps."""

    cost_s = 0.0

    def keep(self, at_s: float, frozen: bytes, cost_s: float) -> None:
        self.cost_s += cost_s
        super().keep(at_s, frozen, cost_s)


def measure(quick: bool) -> list[Figure]:
    """CPU seconds; a place from the beginning and the same place from the end of the flight in turn."""
    flight_s, places = (120.0, 4) if quick else (900.0, 8)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "flight.tlog"
        _write(path, flight_s)
        kept: list[_Costed] = []
        flown = _playback(path, kept)
        whole_s = _go_to(flown, flown.state.last_s)
        rng = random.Random(5)
        anew_s, back_s = [], []
        for _ in range(places):
            place_s = rng.uniform(flown.state.first_s, flown.state.last_s)
            anew_s.append(_go_to(_playback(path, []), place_s))
            back_s.append(_go_to(flown, place_s))
            _go_to(flown, flown.state.last_s)
    mean_s, share, store = statistics.fmean(back_s), kept[0].cost_s / whole_s, kept[0]
    return [
        Figure(
            "seek",
            f"to a place in a flight of {flight_s / 60:.0f} min that was passed before, CPU",
            f"mean {mean_s:.2f} s, most {max(back_s):.2f} s (from the beginning {statistics.fmean(anew_s):.1f} s)",
            f"mean <= {_MOST_MEAN_S:.1f} s",
            mean_s <= _MOST_MEAN_S,
        ),
        Figure(
            "seek",
            "keeping the states, of the CPU time of the replay",
            f"{share:.1%} ({len(store)} of them, {store.size_bytes / 1e6:.0f} MB)",
            f"<= {_MOST_SHARE:.0%}",
            share <= _MOST_SHARE,
        ),
    ]


def _write(path: Path, flight_s: float) -> None:
    fleet = Fleet(load_scenario(_SCENARIO), seed=3, unix_epoch_s=_EPOCH_S)
    with path.open("wb") as file:
        for step in range(1, round(flight_s * 50) + 1):
            for datagram in fleet.advance(step * 0.02):
                file.write(struct.pack(">Q", round((_EPOCH_S + datagram.due_s) * 1e6)) + datagram.payload)


def _playback(path: Path, kept: list[_Costed]) -> Playback:
    def begin(on_poll: OnPoll) -> Replay:
        return Replay(Engine(load_estimator("fleet", {})), TlogReader(path), [], on_poll)

    def keeping(beginning: bytes) -> Checkpoints:
        kept.append(_Costed(beginning))
        return kept[0]

    return Playback(begin, Playhead(*TlogReader(path).span(), float("inf")), TrackHistory(), keeping)


def _go_to(playback: Playback, place_s: float) -> float:
    """The CPU seconds that it took."""
    began_s = time.process_time()
    playback.obey(PlaybackCommand(playing=False, seek_s=place_s))
    while playback.state.goal_s is not None:
        playback.go_on(time.process_time)
    return time.process_time() - began_s
