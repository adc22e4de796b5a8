"""The journal as MCAP, the file format of Foxglove and Lichtblick: JSON messages with their schemas."""

from __future__ import annotations

import json

from gcs_coloc.recorder.journal import NAMES, Entry, VehicleEntry, as_json, schema_of
from gcs_coloc.recorder.mcap_writer import McapWriter


class McapEncoder:
    """Entries to the bytes of one MCAP file. What `take` has handed out opens after a crash."""

    def __init__(self) -> None:
        self._writer = McapWriter("gcs-coloc")
        self._schemas = {
            kind: self._writer.schema(f"gcs_coloc.{name}", json.dumps(schema_of(kind)).encode()) for kind, name in NAMES.items()
        }
        self._channels: dict[str, int] = {}

    def add(self, entry: Entry) -> None:
        """Add one entry at its own time. Topics: /vehicle/N, /range, /health, /notice."""
        kind = type(entry)
        topic = f"/vehicle/{entry.vehicle.sysid}" if isinstance(entry, VehicleEntry) else f"/{NAMES[kind]}"
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.channel(topic, self._schemas[kind])
        self._writer.message(channel, round(entry.at_s * 1e6) * 1000, as_json(entry))

    def take(self) -> bytes:
        """The bytes of what was added since the last call. Each call makes a chunk, which costs as much as several entries."""
        return self._writer.take()

    def finish(self) -> bytes:
        """The last bytes, with the index and the end mark."""
        return self._writer.finish()
