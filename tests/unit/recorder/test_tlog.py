"""Tlogs of an independent writer are read whole, and damage costs only what is damaged."""

import gzip
import os
import struct

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.errors import DataError
from gcs_coloc.recorder.tlog import SEARCHED_BYTES, TlogReader
from tests.recordings import recording

STARTED_US = 1_700_000_000_000_000


def frame(sequence, force_mavlink1=False):
    sender = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
    sender.seq = sequence & 0xFF
    message = mavlink.MAVLink_attitude_message(sequence, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    return message.pack(sender, force_mavlink1=force_mavlink1)


def unknown_frame():
    return bytes([0xFD, 9, 0, 0, 5, 1, 1, 0x11, 0x22, 0x33]) + b"\x07" * 9 + b"\x12\x34"


def record(number, content=None):
    return struct.pack(">Q", STARTED_US + number * 100_000) + (content or frame(number))


def reader(tmp_path, content):
    path = tmp_path / "flight.tlog"
    path.write_bytes(content)
    return TlogReader(path)


def numbers(records):
    """Which records came, by their times, each checked to hold its own frame."""
    found = []
    for unix_s, content in records:
        number = round((unix_s - STARTED_US / 1e6) * 10)
        assert content == frame(number)
        found.append(number)
    return found


def test_file_written_by_pymavlink_is_read_whole(tmp_path):
    path = tmp_path / "flight.tlog"
    log = mavutil.mavlogfile(str(path), write=True)
    log.f.close()
    with path.open("wb") as file:
        writer = mavutil.mavlink.MAVLink(file, srcSystem=3, srcComponent=1)
        for number in range(50):
            file.write(struct.pack(">Q", STARTED_US + number * 100_000))
            writer.attitude_send(number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    ours = list(TlogReader(path))
    theirs = mavutil.mavlink_connection(str(path))
    for unix_s, content in ours:
        message = theirs.recv_match()
        assert bytes(message.get_msgbuf()) == content
        assert unix_s == pytest.approx(message._timestamp, abs=1e-5)
    assert theirs.recv_match() is None
    theirs.close()
    assert len(ours) == 50


def test_both_versions_and_unknown_messages_are_read(tmp_path):
    contents = [frame(0), unknown_frame(), frame(2, force_mavlink1=True), unknown_frame()]
    log = reader(tmp_path, b"".join(record(number, content) for number, content in enumerate(contents)))
    assert [content for _, content in log] == contents
    assert dict(log.counts) == {}


def test_record_cut_off_at_the_end_is_reported_and_ends_cleanly(tmp_path):
    whole = b"".join(map(record, range(3)))
    for cut in range(1, len(record(2))):
        log = reader(tmp_path, whole[:-cut])
        assert numbers(log) == [0, 1], cut
        assert dict(log.counts) == {"truncated": 1}


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda good: good[:-4] + b"\xff" + good[-3:], id="bad checksum"),
        pytest.param(lambda good: good[:8] + b"\x00" + good[9:], id="no magic"),
        pytest.param(lambda good: good[:9] + b"\xff" + good[10:], id="length too long"),
        pytest.param(lambda good: good[:20], id="cut in the middle"),
        pytest.param(lambda good: good + b"\xfd\x00\xfe", id="something added"),
        pytest.param(lambda good: good[3:], id="beginning lost"),
    ],
)
def test_reading_goes_on_behind_damage(tmp_path, damage):
    records = [record(number) for number in range(30)]
    damaged = damage(records[10])
    log = reader(tmp_path, b"".join([*records[:10], damaged, *records[11:]]))
    kept = set(numbers(log))
    assert kept >= set(range(30)) - {10}
    assert log.counts["damaged_bytes"] == (len(damaged) if 10 not in kept else len(damaged) - len(records[10]))
    assert log.counts["truncated"] == 0


def test_damage_is_not_taken_for_a_frame_of_an_unknown_message(tmp_path):
    """Its checksum cannot tell, but neither does a record follow where it states to end."""
    shortened = bytearray(unknown_frame())
    shortened[1] -= 4
    log = reader(tmp_path, record(0) + record(1, bytes(shortened)) + record(2))
    assert numbers(log) == [0, 2]
    assert dict(log.counts) == {"damaged_bytes": len(record(1, unknown_frame()))}


def test_reading_goes_on_only_where_a_checksum_is_right(tmp_path):
    damage = bytes(30) + unknown_frame() + bytes(5)
    log = reader(tmp_path, record(0) + damage + record(1))
    assert numbers(log) == [0, 1]
    assert dict(log.counts) == {"damaged_bytes": len(damage)}


def test_damage_at_the_end_is_counted(tmp_path):
    log = reader(tmp_path, record(0) + b"\x00" * 40)
    assert numbers(log) == [0]
    assert dict(log.counts) == {"damaged_bytes": 40}


def test_damage_at_the_beginning_is_passed_over(tmp_path):
    log = reader(tmp_path, b"\x55" * 1000 + record(0))
    assert numbers(log) == [0]
    assert dict(log.counts) == {"damaged_bytes": 1000}


@pytest.mark.parametrize("content", [b"time,lat,lon\n" * 100, b"\xfd" * 5000, b"\x00", record(0)[:-1]])
def test_file_that_is_no_tlog_is_an_error_that_names_it(tmp_path, content):
    with pytest.raises(DataError, match=r"flight\.tlog: is no tlog: no MAVLink frame follows a time at byte 0"):
        list(reader(tmp_path, content))


def test_large_file_that_is_no_tlog_is_not_searched_to_its_end(tmp_path):
    with pytest.raises(DataError, match="no tlog"):
        list(reader(tmp_path, bytes(SEARCHED_BYTES) + record(0)))


def test_empty_missing_and_unreadable_files_are_errors(tmp_path):
    with pytest.raises(DataError, match=r"flight\.tlog: is empty"):
        list(reader(tmp_path, b""))
    with pytest.raises(DataError, match=r"none\.tlog: cannot be read: No such file"):
        list(TlogReader(tmp_path / "none.tlog"))
    with pytest.raises(DataError, match=r"is a directory; a recording is a file, NAME\.tlog"):
        list(TlogReader(tmp_path))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (gzip.compress(record(0), mtime=0), "is compressed; unpack it with gunzip first"),
        (b"PK\x03\x04" + record(0), "is a zip archive"),
        (b"\x89MCAP0\r\n" + bytes(100), "the .tlog that was recorded beside it is wanted"),
        (b"\xa3\x95\x80\x80YFMT" + bytes(100), "is an onboard log of ArduPilot"),
        (b"ULog\x01\x12\x35" + bytes(100), "is an onboard log of PX4"),
        (frame(0) + frame(1) + frame(2), "holds MAVLink frames without times"),
        (frame(0)[5:] + frame(1) + frame(2), "holds MAVLink frames without times"),
        (frame(0), "is no tlog"),
        (b"unix_s,sysid\n1,2\n", "is no tlog"),
    ],
)
def test_what_is_something_else_is_called_by_its_name_with_the_remedy(tmp_path, content, words):
    with pytest.raises(DataError, match=words):
        list(reader(tmp_path, content))


def test_a_pipe_is_refused_before_anything_waits_for_it(tmp_path):
    os.mkfifo(tmp_path / "pipe.tlog")
    with pytest.raises(DataError, match="is no file"):
        list(TlogReader(tmp_path / "pipe.tlog"))


def test_a_record_with_an_impossible_time_is_damage(tmp_path):
    impossible = b"\xff" + record(1)[1:]
    log = reader(tmp_path, record(0) + impossible + record(2))
    assert numbers(log) == [0, 2]
    assert dict(log.counts) == {"damaged_bytes": len(impossible)}


def at(unix_us, number):
    return struct.pack(">Q", unix_us) + frame(number)


@pytest.mark.parametrize("off_us", [-1_600_000_000_000_000, -2_000_000, 2_000_000, 2**51])
def test_a_time_that_is_not_between_those_around_it_is_that_of_the_record_before(tmp_path, off_us):
    """A flipped bit in a time, which no checksum covers; the rest of the flight was replayed at one instant of another year."""
    log = reader(tmp_path, b"".join([record(0), record(1), at(STARTED_US + 200_000 + off_us, 2), record(3), record(4)]))
    assert [round((unix_s - STARTED_US / 1e6) * 10) for unix_s, _ in log] == [0, 1, 1, 3, 4]
    assert dict(log.counts) == {"wrong_times": 1}


def test_a_pause_of_any_length_is_no_wrong_time(tmp_path):
    log = reader(tmp_path, record(0) + record(10_000) + record(20_000) + record(20_001))
    assert numbers(log) == [0, 10_000, 20_000, 20_001]
    assert dict(log.counts) == {}


def test_where_the_clock_went_back_times_go_on(tmp_path):
    """A computer whose clock is set while it records; until it had caught up, all was replayed at one instant."""
    hour_us = 3_600_000_000
    ahead = [at(STARTED_US + hour_us + number * 100_000, number) for number in range(3)]
    log = reader(tmp_path, b"".join([*ahead, record(3), record(4), record(5)]))
    times_s = [unix_s - (STARTED_US + hour_us) / 1e6 for unix_s, _ in log]
    assert times_s == pytest.approx([0.0, 0.1, 0.2, 0.2, 0.3, 0.4], abs=1e-5)
    assert dict(log.counts) == {"clock_went_back": 1}


def test_records_of_two_links_are_a_little_out_of_order(tmp_path):
    log = reader(tmp_path, record(0) + record(5) + record(3) + record(6))
    assert [round((unix_s - STARTED_US / 1e6) * 10) for unix_s, _ in log] == [0, 5, 5, 6]
    assert dict(log.counts) == {}


def test_reading_twice_gives_the_same(tmp_path):
    log = reader(tmp_path, record(0) + record(1))
    assert list(log) == list(log)


def test_recorded_flight_of_four_planes():
    log = TlogReader(recording("arduplane/flight.tlog"))
    records = list(log)
    assert len(records) == 107_516
    assert dict(log.counts) == {}
    times = [unix_s for unix_s, _ in records]
    assert times == sorted(times)
    assert 421.0 < times[-1] - times[0] < 422.0


@pytest.mark.parametrize("tail", [b"", b"\x55" * 100_000, record(9999)[:-3], struct.pack(">Q", 0)])
def test_the_first_and_the_last_time_are_found_without_reading_what_is_between(tmp_path, tail):
    content = b"".join(record(number) for number in range(5000)) + tail
    first_s, last_s = reader(tmp_path, content).span()
    assert (first_s, last_s) == (STARTED_US / 1e6, (STARTED_US + 4999 * 100_000) / 1e6)


def test_what_is_no_tlog_has_no_first_time(tmp_path):
    with pytest.raises(DataError, match="is no tlog"):
        reader(tmp_path, b"\x00" * 1000).span()
