"""Assembles an MCAP file from batches of messages, each batch a chunk with its index: https://mcap.dev/spec.

All records are the MCAP library's but one: its writer takes three times as long for a message, and messages are all that is many.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterable

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

# Opcode and length of the record, channel, sequence, time logged and time published.
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD_BYTES = _MESSAGE.size - 9
_FOOTER_HEAD = struct.Struct("<BQQQ")
_FOOTER_BYTES = 20

END_MARK = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MCAP0_MAGIC
"""Ends an MCAP file without an index. Standing behind what `take` has handed out, it makes a whole file of it."""


class McapWriter:
    """One file. `take` hands out what was added since the last call as one chunk, `finish` the last one and the index."""

    def __init__(self, library: str) -> None:
        """Begin a file that says that `library` has written it."""
        self._out = bytearray(MCAP0_MAGIC + _bytes_of([Header(profile="", library=library)]))
        self._taken = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: Counter[int] = Counter()
        self._chunk = bytearray()
        self._index: dict[int, list[tuple[int, int]]] = {}  # of the chunk, by channel: when each message was logged, where it is

    def schema(self, name: str, json_schema: bytes) -> int:
        """Add a JSON schema; returns its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding="jsonschema", data=json_schema)
        self._schemas.append(schema)
        self._chunk += _bytes_of([schema])
        return schema.id

    def channel(self, topic: str, schema: int) -> int:
        """Add a channel of JSON messages; returns its number."""
        channel = Channel(id=len(self._channels) + 1, topic=topic, message_encoding="json", metadata={}, schema_id=schema)
        self._channels.append(channel)
        self._chunk += _bytes_of([channel])
        return channel.id

    def message(self, channel: int, time_ns: int, data: bytes) -> None:
        """Add a message that was logged and published at one time, nanoseconds since 1970."""
        chunk = self._chunk
        self._index.setdefault(channel, []).append((time_ns, len(chunk)))
        chunk += _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE_HEAD_BYTES + len(data), channel, 0, time_ns, time_ns)
        chunk += data

    def take(self) -> bytes:
        """The bytes of what was added since the last call."""
        self._end_chunk()
        out = bytes(self._out)
        self._out.clear()
        self._taken += len(out)
        return out

    def finish(self) -> bytes:
        """The last bytes: what was added since the last `take`, the summary with the index, and the end mark."""
        self._end_chunk()
        self._out += _bytes_of([DataEnd(data_section_crc=0)])
        start = self._taken + len(self._out)
        summary, offsets = bytearray(), []
        groups: tuple[tuple[Opcode, Iterable[McapRecord]], ...] = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
        )
        for opcode, records in groups:
            group = _bytes_of(records)
            offsets.append(SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group)))
            summary += group
        offsets_start = start + len(summary)
        summary += _bytes_of(offsets)
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, _FOOTER_BYTES, start, offsets_start)
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=zlib.crc32(summary + head))
        self._out += summary + _bytes_of([footer]) + MCAP0_MAGIC
        return self.take()

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=0,
            schema_count=len(self._schemas),
        )

    def _end_chunk(self) -> None:
        """Bring what was added into a chunk with its index behind it; schemas and channels wait for a message."""
        if not self._index:
            return
        data, index, begins_at = bytes(self._chunk), self._index, self._taken + len(self._out)
        self._chunk.clear()
        self._index = {}
        times_ns = [time_ns for messages in index.values() for time_ns, _ in messages]
        chunk = Chunk(
            compression="",
            data=data,
            message_start_time=min(times_ns),
            message_end_time=max(times_ns),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        self._out += _bytes_of([chunk])
        index_at, offsets = self._taken + len(self._out), {}
        for channel, messages in index.items():
            offsets[channel] = self._taken + len(self._out)
            self._out += _bytes_of([MessageIndex(channel_id=channel, records=messages)])
            self._counts[channel] += len(messages)
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=begins_at,
                chunk_length=index_at - begins_at,
                message_index_offsets=offsets,
                message_index_length=self._taken + len(self._out) - index_at,
                compression="",
                compressed_size=len(data),
                uncompressed_size=len(data),
            )
        )


def _bytes_of(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
