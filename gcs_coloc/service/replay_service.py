"""The composition root of a replay on the page: a recording, its playhead and the page's server."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Iterable
from pathlib import Path

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.truth import HeardTruth
from gcs_coloc.recorder.playhead import Playhead
from gcs_coloc.recorder.replay import Replay
from gcs_coloc.recorder.side_tables import TruthTable, read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.web.app import Hooks
from gcs_coloc.web.playback import OnPoll, Playback
from gcs_coloc.web.server import WebServer
from gcs_coloc.web.track_history import TrackHistory


class ReplayService:
    """Serves one recording. `run` lasts until a signal."""

    def __init__(self, file: Path, settings: Settings, ranges: Path | None, truth: Path | None, speed: float) -> None:
        """Read what there is beside the recording, and its beginning and end.

        `speed` in recorded seconds a second.

        Raises:
            DataError: a file cannot be read or is not what it should be.
            EstimatorError: the estimator cannot be loaded.
        """
        own = (settings.mavlink.system_id, settings.mavlink.component_id)
        told = read_ranges(ranges) if ranges is not None else []
        self._table = TruthTable(read_truth(truth)) if truth is not None else None

        def begin(on_poll: OnPoll) -> Replay:
            engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
            return Replay(engine, TlogReader(file), told, on_poll, own, settings.fingerprint())

        story = TrackHistory()
        self._playback = Playback(begin, Playhead(*TlogReader(file).span(), speed), story)
        web = settings.web.model_copy(update={"token_file": ""})
        self._web = WebServer(
            web, Hooks(self._playback.look, self._playback.look, None, lambda: None, self._truths, self._playback), story
        )

    def _truths(self) -> Iterable[HeardTruth]:
        heard = self._playback.replay.truths
        return (heard | self._table.at(self._playback.state.at_s) if self._table is not None else heard).values()

    @property
    def log(self) -> TlogReader:
        """The recording as far as it was read."""
        return self._playback.replay.log

    async def run(self) -> None:
        """Serve until a signal.

        Raises:
            DataError: the recording can no longer be read.
            WebError: the page's address cannot be had.
        """
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._web.stop)
        print(f"web page: {self._web.open()} (Ctrl-C ends)", flush=True)
        playing = asyncio.create_task(self._playback.run())
        serving = asyncio.create_task(self._web.run())
        await asyncio.wait({playing, serving}, return_when=asyncio.FIRST_COMPLETED)
        self._web.stop()
        await serving
        playing.cancel()
        await asyncio.wait({playing})
        if not playing.cancelled():
            playing.result()
