"""The service's side of a recording: what goes into it, or into nothing where none is wanted."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path

from gcs_coloc.config.sections import MavlinkConfig, RecordConfig
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import Outbound
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.mavlink.decoder import Frame
from gcs_coloc.mavlink.framing import RawFrame
from gcs_coloc.recorder.journal import Journal
from gcs_coloc.recorder.recorder import Recorder
from gcs_coloc.recorder.side_channel import GroundTool, SideChannelRecord


class FlightRecording:
    """Hands the flight of one engine to a recorder. Every call returns at once; without a recorder nothing is done."""

    def __init__(self, wanted: RecordConfig, ids: MavlinkConfig, engine: Engine) -> None:
        """Prepare the recording; no file is made before `open`.

        Raises:
            RecordError: its directory cannot be written to.
        """
        where = (Path(wanted.directory), wanted.rotate_mb * 1_000_000, ids.system_id, ids.component_id)
        self._recorder = Recorder(*where) if wanted.directory else None
        self._journal = Journal(engine)
        self._ground_tools: set[tuple[int, int]] = set()

    def open(self) -> None:
        """Begin the files, with all that was handed over so far.

        Raises:
            RecordError: they cannot be made.
        """
        if self._recorder is not None:
            self._recorder.open()

    @property
    def newest_view(self) -> FleetSnapshot | None:
        """The fleet as it was recorded last; None where nothing is."""
        return self._journal.newest_view

    def heard(self, at_s: float, frames: Iterable[RawFrame], refused: Collection[Frame]) -> None:
        """Record the frames of a datagram, but those that were refused: the engine never saw them."""
        if self._recorder is None:
            return
        if not refused:
            for raw in frames:
                self._recorder.frame(at_s, raw.frame)
            return
        left_out = {(frame.sysid, frame.compid, frame.sequence, frame.message_id) for frame in refused}
        for raw in frames:
            if (raw.sysid, raw.compid, raw.sequence, raw.message_id) not in left_out:
                self._recorder.frame(at_s, raw.frame)

    def sent(self, at_s: float, frame: bytes) -> None:
        """Record a frame that we sent, at the engine's time: a record never lies before the one in front of it."""
        if self._recorder is not None:
            self._recorder.frame(at_s, frame)

    def forwarded(self, at_s: float, raw: RawFrame) -> None:
        """Record a ground tool's frame that went on to a vehicle, at the engine's time; the engine never saw it."""
        if self._recorder is None:
            return
        sender = (raw.sysid, raw.compid)
        if sender not in self._ground_tools:
            self._ground_tools.add(sender)
            self._recorder.note(GroundTool(*sender, at_s))
        self._recorder.frame(at_s, raw.frame)

    def told(self, note: SideChannelRecord) -> None:
        """Record what the engine was told besides frames."""
        if self._recorder is not None:
            self._recorder.note(note)

    def polled(self, at_s: float, outputs: list[Outbound]) -> None:
        """Record what came of one deadline of the engine."""
        if self._recorder is not None:
            for entry in self._journal.polled(at_s, outputs):
                self._recorder.entry(entry)

    def news(self) -> tuple[str, str] | None:
        """Level and text for the operator, see `Recorder.news`."""
        return self._recorder.news() if self._recorder is not None else None

    def close(self) -> None:
        """End the recording."""
        if self._recorder is not None:
            self._recorder.close()
