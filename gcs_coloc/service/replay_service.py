"""Replay of a recording on the page: its composition root.

It connects the recording, the pass that computes the page's pictures, and the page's server.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from pathlib import Path

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.errors import DataError
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.side_tables import TruthTable, read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.runtime.process import stop_on_signals
from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.picture_store import PICTURE_PERIOD_S, PictureStore
from gcs_coloc.web.playback import OnPoll, Playback, ReplayPass
from gcs_coloc.web.server import WebServer

_SWITCH_INTERVAL_S = 0.001
"""How long the pass runs on while the page's thread waits for the interpreter. Chosen: Python's 5 ms are 50 ms in a request."""


class ReplayService:
    """Serves one recording. `run` lasts until a signal."""

    def __init__(self, file: Path, settings: Settings, ranges: Path | None, truth: Path | None, speed: float) -> None:
        """Read the tables that come with the recording, and its beginning and end.

        `speed` in recorded seconds a second.

        Raises:
            DataError: a file cannot be read or is not what it should be.
            EstimatorError: the estimator cannot be loaded.
        """
        table_ranges = read_ranges(ranges)
        true_positions = TruthTable(read_truth(truth))

        def make_replay(on_poll: OnPoll) -> Replay:
            engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
            return Replay(engine, TlogReader(file), table_ranges, on_poll, settings.mavlink.own, settings.fingerprint())

        try:
            store = PictureStore(*TlogReader(file).span())
        except OSError as error:
            raise DataError(f"no file can be made in the directory for temporary files: {error.strerror}; set TMPDIR") from None
        self._pass = ReplayPass(make_replay, true_positions.at, store)
        playback = Playback(store, speed)
        web = settings.web.model_copy(update={"token_file": ""})
        self._web = WebServer(web, playback, Pages(playback, IdleScheduler(), PICTURE_PERIOD_S), must_serve=True)

    @property
    def damage(self) -> Mapping[str, int]:
        """What of the recording could not be read so far, by kind."""
        return self._pass.damage

    async def run(self) -> None:
        """Serve until a signal.

        Raises:
            DataError: the recording can no longer be read, or its pictures cannot be kept.
            WebError: the page's address is in use or cannot be listened on, or the page has failed.
        """
        stop_on_signals(self._web.stop)
        print(f"web page: {self._web.open()} (Ctrl-C ends)", flush=True)
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        computing = asyncio.create_task(asyncio.to_thread(self._pass.run))
        computing.add_done_callback(self._stop_after_failure)
        try:
            await self._web.run()
        finally:
            self._pass.stop()
            await computing

    def _stop_after_failure(self, computing: asyncio.Task[None]) -> None:
        if computing.exception() is not None:
            self._web.stop()
