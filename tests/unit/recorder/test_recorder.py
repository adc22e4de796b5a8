"""The recorder's files: rotation, what is kept out, and that a part begins with what the engine had been told."""

from __future__ import annotations

import errno
import os
import re
import struct
import threading
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.errors import RecordError
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, RouteReport
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.mavlink.refusals import Refusal
from gcs_coloc.recorder.journal import StationEntry
from gcs_coloc.recorder.log_segment import delete_oldest
from gcs_coloc.recorder.recorder import Recorder
from gcs_coloc.recorder.side_channel import read_side_channel
from gcs_coloc.recorder.tlog import TlogReader, tlog_record

AT_S = 1_795_216_162.424732
OWN = (254, 191)
MAST = StationSnapshot(3, -4, "mast", "configuration", 47.0, 8.0, 512.0, 0.1, 0.1, (50.0, -20.0, 12.0), 0.1, None, True)


def sender(*, key: bytes | None = None):
    mav = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
    if key is not None:
        mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = key, True, 1
    return mav


def attitude(mav, number: int) -> bytes:
    mav.seq = number & 0xFF
    return mavlink.MAVLink_attitude_message(number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6).pack(mav)


def test_a_signature_is_stripped_to_what_the_unsigned_frame_would_have_been():
    signed, plain = attitude(sender(key=bytes(32)), 7), attitude(sender(), 7)
    assert len(signed) == len(plain) + 13
    assert tlog_record(AT_S, signed) == struct.pack(">Q", 1_795_216_162_424_732) + plain
    assert tlog_record(AT_S, plain)[8:] == plain


def test_the_key_and_what_cannot_be_stripped_are_left_out():
    setup = mavlink.MAVLink_setup_signing_message(1, 1, list(range(32)), 1)
    assert tlog_record(AT_S, setup.pack(sender())) == b""
    unknown = bytes([0xFD, 9, 0, 0, 5, 1, 1, 0x11, 0x22, 0x33]) + b"\x07" * 9 + b"\x12\x34"
    assert tlog_record(AT_S, unknown)[8:] == unknown
    assert tlog_record(AT_S, unknown[:2] + b"\x01" + unknown[3:] + bytes(13)) == b""


def test_the_oldest_recordings_are_deleted_beyond_a_limit_and_nothing_else(tmp_path):
    now_s = time.time()
    for i, age_s in enumerate((4000.0, 3000.0, 2000.0, 1.0)):
        for suffix in ("tlog", "mcap"):
            path = tmp_path / f"gcs-coloc-20260101T00000{i}Z-001.{suffix}"
            path.write_bytes(bytes(10_000))
            os.utime(path, (now_s - age_s, now_s - age_s))
    for other in ("mine.tlog", "gcs-coloc-notes.txt"):
        (tmp_path / other).write_bytes(bytes(90_000))
        os.utime(tmp_path / other, (0.0, 0.0))
    # Room for 60 kB, of which 20 kB are kept free for the new one: two of the four stay, and the one in use whatever it takes.
    recorder = Recorder(tmp_path, 20_000, *OWN, keep_bytes=60_000)
    recorder.open()
    recorder.add_frame(AT_S, attitude(sender(), 0))
    recorder.close()
    left = sorted(path.name[10:26] for path in tmp_path.glob("gcs-coloc-2026*.tlog"))
    assert left[:2] == ["20260101T000002Z", "20260101T000003Z"]
    assert len(left) == 3  # with the new one
    assert sorted(path.name for path in tmp_path.iterdir() if path.stat().st_size == 90_000) == [
        "gcs-coloc-notes.txt",
        "mine.tlog",
    ]
    recorder = Recorder(tmp_path, 20_000, *OWN, keep_bytes=20_000)
    recorder.open()
    recorder.close()
    assert [path.name[10:26] for path in tmp_path.glob("gcs-coloc-20260101*.tlog")] == ["20260101T000003Z"]


@pytest.mark.parametrize("older", ["tlog", "mcap"])
def test_both_files_of_a_segment_are_deleted_or_none(tmp_path, older):
    now_s = time.time()
    for i, age_s in enumerate((4000.0, 3000.0, 50.0)):
        for suffix in ("tlog", "mcap"):
            path = tmp_path / f"gcs-coloc-20260101T00000{i}Z-001.{suffix}"
            path.write_bytes(bytes(10_000))
            written_s = now_s - age_s - 100.0 * (suffix == older)
            os.utime(path, (written_s, written_s))
    delete_oldest(tmp_path, 55_000)
    assert sorted(path.name[10:26] for path in tmp_path.glob("*.tlog")) == ["20260101T000001Z", "20260101T000002Z"]
    assert len(list(tmp_path.iterdir())) == 4
    delete_oldest(tmp_path, 0)
    assert len(list(tmp_path.glob("*T000002Z*"))) == len(list(tmp_path.iterdir())) == 2  # one of the last was just written to


def test_two_recordings_that_begin_in_one_second_get_names_of_their_own(tmp_path):
    recorders = [Recorder(tmp_path, 20_000, *OWN) for _ in range(3)]
    for recorder in recorders:
        recorder.open()
    for number, recorder in enumerate(recorders):
        recorder.add_frame(AT_S, attitude(sender(), number))
        recorder.close()
    logs = sorted(tmp_path.glob("*.tlog"))
    assert len(logs) == len(list(tmp_path.glob("*-001.mcap"))) == 3
    assert {len(list(TlogReader(log))) for log in logs} == {2}  # what a part begins with, and the one frame of its own


def test_a_file_in_the_place_of_the_directory_is_named_as_one(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match="cannot be written to: it is a file and no directory"):
        Recorder(tmp_path / "file", 20_000, *OWN)


def test_parts_turn_over_by_size_join_to_the_whole_and_begin_with_what_was_told(tmp_path):
    frames = [attitude(sender(), number) for number in range(3000)]
    recorder = Recorder(tmp_path, 20_000, *OWN)
    recorder.open()
    recorder.add_record(OperatorCommand(4, AT_S, GpsOverride.FAILED))
    recorder.add_record(RouteReport(3, AT_S, None))
    recorder.add_record(RouteReport(3, AT_S, None))
    for number, frame in enumerate(frames):
        recorder.add_frame(AT_S + number * 0.01, frame)
    recorder.close()
    parts = sorted(tmp_path.glob("*.tlog"))
    assert len(parts) > 3
    assert [p.stem for p in sorted(tmp_path.glob("*.mcap"))] == [p.stem for p in parts]
    assert all(p.stat().st_size < 20_000 + 200 * 60 for p in parts)
    heard = []
    for part in parts:
        records = list(TlogReader(part))
        assert read_side_channel(records[0].frame, 0.0, OWN).record is None
        heard += [record for record in records if read_side_channel(record.frame, 0.0, OWN) is None]
    assert [record.frame for record in heard] == frames
    assert heard[5].unix_s == round((AT_S + 0.05) * 1e6) / 1e6


def test_every_part_tells_of_the_stations(tmp_path):
    recorder = Recorder(tmp_path, 1, *OWN)
    recorder.open()
    recorder.add_entry(StationEntry(AT_S, MAST))
    for number in range(200):  # with the entry one more than a batch
        recorder.add_frame(AT_S + number * 0.01, attitude(sender(), number))
    recorder.close()
    parts = sorted(tmp_path.glob("*.mcap"))
    assert len(parts) == 2
    for part in parts:
        with part.open("rb") as file:
            assert [channel.topic for _, channel, _ in make_reader(file).iter_messages()] == ["/station", "/scene"]


def test_a_disk_that_hangs_is_told_in_one_line_and_what_waits_is_bounded(tmp_path, monkeypatch):
    """The real files; only the system's write waits, as it does on a disk that hangs."""
    real, begun, go = os.pwrite, threading.Event(), threading.Event()

    def hanging(*arguments):
        begun.set()
        go.wait()
        return real(*arguments)

    recorder = Recorder(tmp_path, 10**9, *OWN)
    recorder.open()
    monkeypatch.setattr(os, "pwrite", hanging)
    frame = attitude(sender(), 1)
    try:
        recorder.add_frame(AT_S, frame)
        assert begun.wait(60)
        assert recorder.pending_warning() is None
        for number in range(25_000):
            recorder.add_frame(AT_S + number * 0.01, frame)
        assert recorder.counts[Refusal.NOT_RECORDED] == 5001
        later_s = time.monotonic() + 6.0
        monkeypatch.setattr(time, "monotonic", lambda: later_s)
        level, text = recorder.pending_warning()
        assert level == "error"
        assert re.fullmatch(r"nothing is being recorded: .*: the disk has not answered for 5 s; the flight goes on", text)
        assert recorder.pending_warning() is None
    finally:
        monkeypatch.undo()
        go.set()
    recorder.close()
    assert recorder.pending_warning() == ("info", "recording again; 5001 frames and entries were lost")
    [path] = tmp_path.glob("*.tlog")
    assert sum(1 for _ in TlogReader(path)) == 1 + 20_000
    assert not TlogReader(path).counts


@pytest.mark.parametrize(("call", "rotate_bytes"), [("pwrite", 10**9), ("open", 1)])
def test_a_batch_that_fails_is_written_once_and_in_its_place_when_there_is_room_again(call, rotate_bytes, tmp_path, monkeypatch):
    """The real files; only the system refuses to write, or to make the next segment, as it does on a full disk."""
    real, full = getattr(os, call), threading.Event()

    def on_a_full_disk(*arguments):
        if full.is_set():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(*arguments)

    def told():
        records = [read_side_channel(record.frame, 0.0, OWN) for path in logs() for record in TlogReader(path)]
        return [(read.record.override, read.repeated) for read in records if isinstance(read.record, OperatorCommand)]

    def logs():
        return sorted(tmp_path.glob("*.tlog"))

    def wait_until(is_so):
        until_s = time.monotonic() + 60.0
        while not is_so():
            assert time.monotonic() < until_s
            time.sleep(0.01)

    monkeypatch.setattr(os, call, on_a_full_disk)
    monkeypatch.setattr("gcs_coloc.recorder.recorder._RETRY_S", 0.0)
    recorder = Recorder(tmp_path, rotate_bytes, *OWN)
    recorder.open()
    recorder.add_record(OperatorCommand(4, AT_S, GpsOverride.HEALTHY))
    wait_until(lambda: any(path.stat().st_size for path in logs()))
    full.set()
    too_long = 10**30
    recorder.add_record(PeerRange(3, AT_S, 4, 1 / 3, 1 / 3, AT_S, TimeBase.UNIX, too_long, 0.5, too_long))
    recorder.add_record(OperatorCommand(4, AT_S, GpsOverride.FAILED))
    wait_until(lambda: recorder.pending_warning() is not None)
    full.clear()
    recorder.close()
    assert len(logs()) == 2
    assert told() == [(GpsOverride.HEALTHY, False), (GpsOverride.HEALTHY, True), (GpsOverride.FAILED, False)]
    assert recorder.counts[Refusal.NOT_RECORDED] == 1  # the range


def test_a_directory_that_is_none_is_an_error_that_names_it(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match=r"--record .*file: cannot be written to"):
        Recorder(tmp_path / "file", 10**6, *OWN)


def test_a_disk_that_is_mounted_read_only_is_called_so():
    mounts = [line.split() for line in Path("/proc/mounts").read_text().splitlines()]
    read_only = [Path(where) for _, where, _, options, *_ in mounts if "ro" in options.split(",") and Path(where).is_dir()]
    if not read_only:
        pytest.skip("nothing is mounted read-only here")
    with pytest.raises(RecordError, match="cannot be written to: Read-only file system"):
        Recorder(read_only[0], 10**6, *OWN)
