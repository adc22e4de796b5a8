"""The journal as MCAP, the file format of Foxglove and Lichtblick: JSON messages with their schemas."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Mapping
from functools import cache
from typing import Any

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from pydantic import TypeAdapter
from pydantic_core import to_json

from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.recorder.formats.foxglove import FoxgloveMessages, well_known_schema
from gcs_coloc.recorder.journal import Entry, RangeEntry, StationEntry, VehicleEntry

NAMES: Mapping[type, str] = {
    VehicleEntry: "vehicle",
    RangeEntry: "range",
    StationEntry: "station",
    HealthChanged: "health",
    Notice: "notice",
    Alarm: "alarm",
}
_ADAPTERS: Mapping[type, TypeAdapter[Any]] = {kind: TypeAdapter(kind) for kind in NAMES}


def as_json(entry: Entry) -> bytes:
    """An entry as one JSON object; a number that is not finite becomes null."""
    encoded: bytes = _ADAPTERS[type(entry)].dump_json(entry)
    return encoded


@cache  # each log segment begins with all of them
def schema_of(kind: type) -> bytes:
    """The JSON schema of one kind of entry, without references: some viewers follow none."""
    schema = _ADAPTERS[kind].json_schema(mode="serialization")
    return json.dumps(_inline(schema, schema.pop("$defs", {}))).encode()


def _inline(part: Any, definitions: Mapping[str, Any]) -> Any:
    if isinstance(part, list):
        return [_inline(item, definitions) for item in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _inline(definitions[part["$ref"].rpartition("/")[2]], definitions)
    return {key: _inline(value, definitions) for key, value in part.items()}


END_MARK = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MCAP0_MAGIC
"""Ends an MCAP file without an index. Written behind the bytes of `pop`, it completes the file."""


class McapEncoder:
    """Entries to the bytes of one MCAP file. The bytes of `pop` can be opened after a crash."""

    def __init__(self) -> None:
        self._sink = _Sink()
        self._writer = Writer(self._sink, compression=CompressionType.NONE)
        self._writer.start(profile="", library="gcs-coloc")
        self._schemas = {
            kind: self._writer.register_schema(f"gcs_coloc.{name}", "jsonschema", schema_of(kind)) for kind, name in NAMES.items()
        }
        self._well_known = {
            name: self._writer.register_schema(name, "jsonschema", well_known_schema(name))
            for name in ("foxglove.LocationFix", "foxglove.SceneUpdate", "foxglove.Log")
        }
        self._foxglove = FoxgloveMessages()
        self._channels: dict[str, int] = {}

    def add(self, entry: Entry) -> None:
        """Add one entry at its own time, as a message of ours and as messages of Foxglove's.

        Our topics are /vehicle/N, /station, /range, /health, /notice and /alarm.
        """
        kind, time_ns = type(entry), round(entry.at_s * 1e6) * 1000
        topic = f"/vehicle/{entry.vehicle.sysid}" if isinstance(entry, VehicleEntry) else f"/{NAMES[kind]}"
        self._add_message(topic, self._schemas[kind], time_ns, as_json(entry))
        for topic, schema, content in self._foxglove.messages(entry):
            self._add_message(topic, self._well_known[schema], time_ns, to_json(content))

    def _add_message(self, topic: str, schema: int, time_ns: int, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.register_channel(topic, "json", schema)
        self._writer.add_message(channel, time_ns, data, time_ns)

    def pop(self) -> bytes:
        """Return the bytes of what was added since the last call.

        Each call makes a chunk, which costs as much as two entries.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        return self._sink.pop()

    def finish(self) -> bytes:
        """The last bytes, with the index and the end mark."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        return self._sink.pop()


class _Sink(io.BytesIO):
    """Collects what the MCAP writer writes; `tell` continues over what was popped."""

    def __init__(self) -> None:
        super().__init__()
        self._popped = 0

    def tell(self) -> int:
        """The offset in the file."""
        return self._popped + super().tell()

    def pop(self) -> bytes:
        """Everything that was written since the last call."""
        data = self.getvalue()
        self._popped += len(data)
        self.seek(0)
        self.truncate()
        return data
