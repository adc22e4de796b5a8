"""The service's side of a recording: frames, side-channel records and journal of one engine's flight."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from gcs_coloc.config.sections import MavlinkConfig
from gcs_coloc.config.service_sections import RecordConfig
from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import Outbound
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.mavlink.decoder import Frame
from gcs_coloc.mavlink.framing import RawFrame
from gcs_coloc.recorder.journal import Journal
from gcs_coloc.recorder.side_channel import GroundTool, SideChannelRecord

if TYPE_CHECKING:
    from gcs_coloc.recorder.recorder import Recorder


class FlightRecording:
    """The recording of one engine's flight, passed on to a recorder.

    A call that records returns at once. Where no directory is set, every call does nothing.
    """

    def __init__(self, wanted: RecordConfig, ids: MavlinkConfig, engine: Engine) -> None:
        """Prepare the recording; no file is created before `open`.

        Raises:
            RecordError: its directory cannot be written to.
        """
        self._recorder: Recorder | None = None
        if wanted.directory:
            # Imported here: a service that records nothing starts without what a recording needs.
            from gcs_coloc.recorder.recorder import Recorder

            keep_bytes = round(wanted.keep_gb * 1e9) or None
            where = (Path(wanted.directory), wanted.rotate_mb * 1_000_000)
            self._recorder = Recorder(*where, ids.system_id, ids.component_id, keep_bytes)
        self._journal = Journal(engine)
        self._ground_tools: set[tuple[int, int]] = set()

    def open(self) -> None:
        """Create the files, with everything that was recorded so far.

        Raises:
            RecordError: they cannot be created.
        """
        if self._recorder is not None:
            self._recorder.open()

    @property
    def newest_snapshot(self) -> FleetSnapshot | None:
        """The fleet as it was recorded last; None where nothing is recorded."""
        return self._journal.newest_snapshot

    def record_received(self, at_s: float, frames: Iterable[RawFrame], refused: Collection[Frame]) -> None:
        """Record the frames of a datagram without those that were refused, which the engine never received."""
        if self._recorder is None:
            return
        if not refused:
            for raw in frames:
                self._recorder.add_frame(at_s, raw.frame)
            return
        left_out = {(frame.sysid, frame.compid, frame.sequence, frame.message_id) for frame in refused}
        for raw in frames:
            if (raw.sysid, raw.compid, raw.sequence, raw.message_id) not in left_out:
                self._recorder.add_frame(at_s, raw.frame)

    def record_sent(self, at_s: float, frame: bytes) -> None:
        """Record a frame that we sent, at the engine's time, so that records are in order of time."""
        if self._recorder is not None:
            self._recorder.add_frame(at_s, frame)

    def record_forwarded(self, at_s: float, raw: RawFrame) -> None:
        """Record a ground tool's frame that was forwarded to a vehicle.

        `at_s` is the engine's time. The engine itself never received the frame.
        """
        if self._recorder is None:
            return
        sender = (raw.sysid, raw.compid)
        if sender not in self._ground_tools:
            self._ground_tools.add(sender)
            self._recorder.add_record(GroundTool(*sender, at_s))
        self._recorder.add_frame(at_s, raw.frame)

    def record_side_channel(self, record: SideChannelRecord) -> None:
        """Record what the engine received besides frames."""
        if self._recorder is not None:
            self._recorder.add_record(record)

    def record_outputs(self, at_s: float, outputs: list[Outbound]) -> None:
        """Record the outputs of one deadline of the engine."""
        if self._recorder is not None:
            for entry in self._journal.entries(at_s, outputs):
                self._recorder.add_entry(entry)

    def record_alarm(self, alarm: Alarm) -> None:
        """Record the change of an alarm."""
        if self._recorder is not None:
            self._recorder.add_entry(alarm)

    def pending_warning(self) -> tuple[str, str] | None:
        """Level and text for the operator, see `Recorder.pending_warning`."""
        return self._recorder.pending_warning() if self._recorder is not None else None

    def close(self) -> None:
        """End the recording."""
        if self._recorder is not None:
            self._recorder.close()
