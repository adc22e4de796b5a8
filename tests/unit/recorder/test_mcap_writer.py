"""An MCAP file of ours is what the format's own library writes of the same messages, and reads."""

import io
import zlib

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.writer import CompressionType, Writer

from gcs_coloc.recorder.mcap_writer import END_MARK, McapWriter

BATCHES = (3, 0, 40, 1, 17)


def messages(seed=5):
    """Batches of (topic, time in ns, data): topics that come later than the first, times that go back, empty data."""
    rng = np.random.default_rng(seed)
    at_ns = 1_700_000_000_000_000_000
    for count in BATCHES:
        batch = []
        for _ in range(count):
            at_ns += int(rng.integers(-5_000, 200_000_000))
            batch.append(
                (f"/vehicle/{rng.integers(1, 6)}", at_ns, bytes(rng.integers(32, 127, int(rng.integers(0, 900))).tolist()))
            )
        yield batch


def ours():
    """The parts in which a file is handed out."""
    writer, channels, parts = McapWriter("gcs-coloc"), {}, []
    schema = writer.schema("a", b"{}")
    for batch in messages():
        for topic, at_ns, data in batch:
            if topic not in channels:
                channels[topic] = writer.channel(topic, schema)
            writer.message(channels[topic], at_ns, data)
        parts.append(writer.take())
    return [*parts, writer.finish()]


def theirs():
    out, channels = io.BytesIO(), {}
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start(profile="", library="gcs-coloc")
    schema = writer.register_schema("a", "jsonschema", b"{}")
    for batch in messages():
        for topic, at_ns, data in batch:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], at_ns, data, at_ns)
        writer.flush()
    writer.finish()
    return out.getvalue()


def test_up_to_the_summary_it_is_byte_for_byte_what_the_library_writes_and_the_summary_says_the_same():
    file, reference = b"".join(ours()), theirs()
    summary, expected = (vars(make_reader(io.BytesIO(data)).get_summary()) for data in (file, reference))
    assert summary == expected
    begins_at = int.from_bytes(file[-28:-20], "little")
    assert begins_at > 20_000
    assert file[:begins_at] == reference[:begins_at]
    assert int.from_bytes(file[-12:-8], "little") == zlib.crc32(file[begins_at:-12])


@pytest.mark.parametrize("parts", range(1, len(BATCHES) + 1))
def test_what_was_handed_out_so_far_is_a_whole_file_with_the_mark_behind_it(parts):
    file = b"".join(ours()[:parts]) + END_MARK
    read = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(io.BytesIO(file), validate_crcs=True).iter_messages()]
    assert sorted(read) == sorted(m for batch in list(messages())[:parts] for m in batch)


def test_by_the_index_a_reader_finds_one_topic_in_a_span_of_time():
    written = [m for batch in messages() for m in batch]
    from_ns, to_ns = written[20][1], written[50][1]
    reader = make_reader(io.BytesIO(b"".join(ours())), validate_crcs=True)
    read = [
        (c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages("/vehicle/3", starting_at=from_ns, ending_before=to_ns)
    ]
    assert read == sorted((m for m in written if m[0] == "/vehicle/3" and from_ns <= m[1] < to_ns), key=lambda m: m[1])
    assert len(read) > 3


def test_a_file_without_any_message_opens():
    summary = make_reader(io.BytesIO(McapWriter("gcs-coloc").finish())).get_summary()
    assert summary.statistics.message_count == 0


def test_a_schema_waits_for_the_first_message():
    writer = McapWriter("gcs-coloc")
    number = writer.schema("a", b"{}")
    head = writer.take()
    writer.message(writer.channel("/a", number), 1, b"{}")
    file = head + writer.finish()
    ((schema, channel, message),) = make_reader(io.BytesIO(file)).iter_messages()
    assert schema == Schema(id=1, name="a", encoding="jsonschema", data=b"{}")
    assert (channel.topic, message.data) == ("/a", b"{}")
