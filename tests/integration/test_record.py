"""A flight recorded by the running service: it opens elsewhere, survives a kill, replays to the last bit, and costs no flight."""

from __future__ import annotations

import json
import re
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from brokers import wait_until
from command_line import gcs_coloc
from mcap.reader import make_reader
from pymavlink import mavutil
from vehicles import Hover, fly, square_fleet

from bench.free_ports import free_port as free_port_of
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import GpsInput
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.formats.mcap_file import as_json
from gcs_coloc.recorder.journal import Journal, VehicleEntry
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader

pytestmark = pytest.mark.integration


def only(directory: Path, ending: str) -> Path:
    [path] = directory.glob(f"*.{ending}")
    return path


def journal_of(*recordings: Path) -> tuple[list[bytes], list[GpsInput]]:
    """What a replay makes of recordings one after the other: the journal's vehicles as JSON, and the GPS_INPUT."""
    joined = recordings[0].with_name("joined.replayed")
    joined.write_bytes(b"".join(path.read_bytes() for path in recordings))
    engine = Engine(load_estimator("fleet", {}))
    journal, vehicles, sent = Journal(engine), [], []

    def on_poll(at_s, outputs):
        vehicles.extend(as_json(e) for e in journal.entries(at_s, outputs) if isinstance(e, VehicleEntry))
        sent.extend(o for o in outputs if isinstance(o, GpsInput))

    replay(Replay(engine, TlogReader(joined), [], on_poll))
    return vehicles, sent


def located(vehicle: Hover) -> int:
    return sum(message.fix_type == 3 for message in vehicle.of("GPS_INPUT"))


def vehicle_entries(directory: Path) -> int:
    """How many there are so far in a file that is still being written: its summary is missing, and nothing is compressed."""
    return only(directory, "mcap").read_bytes().count(b'"vehicle":{"sysid":')


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> Path:
    """A flight to the orderly end of the service: vehicle 4 loses its GPS by the operator's word, and the service is held up."""
    directory = tmp_path_factory.mktemp("recorded")
    port = free_port_of()
    service = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "gcs_coloc",
            "--udp",
            f"127.0.0.1:{port}",
            "--record",
            str(directory),
            "--failed",
            "4",
            "--no-web",
        ],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert service.stderr is not None
        assert any("listening on" in line for line in service.stderr)
        with square_fleet(port) as fleet:
            fly(fleet, 5.0, failed=[4])
            # Held up for longer than it catches up with: the replay has to know.
            service.send_signal(signal.SIGSTOP)
            fly(fleet, 2.0, failed=[4])
            service.send_signal(signal.SIGCONT)
            fly(fleet, 3.0, failed=[4])
            # On a busy machine the service skips deadlines, and comes to as much in a longer flight.
            fly(fleet, 60.0, failed=[4], until=lambda: located(fleet[3]) > 40 and vehicle_entries(directory) > 4 * 2.5 * 6)
        service.send_signal(signal.SIGTERM)
        service.communicate(timeout=60)
    finally:
        service.kill()
    return directory


@pytest.fixture(scope="module")
def replayed(flown) -> tuple[list[bytes], list[GpsInput]]:
    """What a replay makes of that flight."""
    return journal_of(only(flown, "tlog"))


def live_vehicles(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        return [m.data for _, channel, m in make_reader(file).iter_messages(log_time_order=False) if "vehicle" in channel.topic]


def test_the_replay_computes_what_the_live_run_computed_to_the_last_bit(flown, replayed):
    live, (computed, _) = live_vehicles(only(flown, "mcap")), replayed
    assert len(live) > 4 * 2.5 * 6
    assert live[: len(computed)] == computed
    # The live run went on after the last frame that was heard, on a busy machine for longer; the replay ends with that frame.
    heard_s = max(record.unix_s for record in TlogReader(only(flown, "tlog")) if record.frame[5] != 254)
    assert len(computed) >= sum(json.loads(entry)["at_s"] < heard_s for entry in live)
    located = [json.loads(v)["vehicle"] for v in computed]
    assert any(v["sysid"] == 4 and v["aiding_has_fix"] and v["lat_deg"] is not None for v in located)


def test_the_replay_is_the_same_every_time(flown, replayed):
    assert journal_of(only(flown, "tlog")) == replayed


def test_pymavlink_reads_the_tlog_with_both_directions(flown):
    log = mavutil.mavlink_connection(str(only(flown, "tlog")))
    heard, sent, times = {}, {}, []
    while (message := log.recv_match()) is not None:
        assert message.get_type() != "BAD_DATA"
        times.append(message._timestamp)
        side = sent if message.get_srcSystem() == 254 else heard
        side[message.get_type()] = side.get(message.get_type(), 0) + 1
    log.close()
    assert times == sorted(times)
    assert heard["GLOBAL_POSITION_INT"] >= 4 * 75
    assert sent["GPS_INPUT"] >= 40
    assert {"HEARTBEAT", "COMMAND_LONG", "TUNNEL"} <= set(sent)


def test_the_gps_input_that_was_sent_is_what_the_replay_says(flown, replayed):
    log = mavutil.mavlink_connection(str(only(flown, "tlog")))
    sent, last_heard_s = [], 0.0
    while (message := log.recv_match()) is not None:
        if message.get_srcSystem() != 254:
            last_heard_s = message._timestamp
        elif message.get_type() == "GPS_INPUT":
            sent.append((message._timestamp, (message.time_usec, message.fix_type, message.lat, message.lon)))
    log.close()
    _, outputs = replayed
    computed = {(o.time_usec, o.fix_type, round(o.lat_deg * 1e7), round(o.lon_deg * 1e7)) for o in outputs}
    # The live run goes on after the last frame that is heard, on a busy machine for longer; the replay ends with that frame.
    within = [fix for at_s, fix in sent if at_s < last_heard_s and fix[1] == 3]
    assert len(within) > 30
    assert set(within) <= computed


def test_the_mcap_file_has_schemas_that_its_messages_meet(flown):
    with only(flown, "mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        topics = {channel.topic for channel in summary.channels.values()}
        assert {"/vehicle/1", "/vehicle/4", "/range", "/health", "/notice"} <= topics
        for schema, channel, message in make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            described, value = json.loads(schema.data), json.loads(message.data)
            assert described["type"] == "object"
            properties = set(described["properties"])
            # Foxglove's schemas have fields that not every message fills.
            assert set(value) <= properties if schema.name.startswith("foxglove.") else set(value) == properties
            assert "$ref" not in schema.data.decode()


def test_what_was_written_before_a_kill_opens_and_replays(start_service, free_port, tmp_path):
    service = start_service("--udp", f"127.0.0.1:{free_port}", "--record", str(tmp_path), "--no-web")
    with square_fleet(free_port) as fleet:
        fly(fleet, 5.0)
        fly(fleet, 60.0, until=lambda: vehicle_entries(tmp_path) > 4 * 2.5 * 2.5)
        service.kill()
        service.wait()
        ended_us = max(m for m in times_us(only(tmp_path, "tlog")))
    replayed, _ = journal_of(only(tmp_path, "tlog"))
    assert replayed
    live, newest_ns = [], 0
    with only(tmp_path, "mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            newest_ns = max(newest_ns, message.log_time)
            if "vehicle" in channel.topic:
                live.append(message.data)
    assert abs(newest_ns / 1e3 - ended_us) < 1e6
    assert len(live) > 4 * 2.5 * 2.5


def times_us(path: Path) -> list[int]:
    return [round(record.unix_s * 1e6) for record in TlogReader(path)]


def test_a_disk_that_is_full_is_told_and_the_flight_goes_on(free_port, tmp_path):
    """RLIMIT_FSIZE: the system refuses to let a file grow beyond 40 kB, as it does on a full disk."""
    limit = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (40000, 40000)); "
    run = "from gcs_coloc.cli.main import main; sys.argv[1:] = sys.argv[1:]; main()"
    command = [sys.executable, "-c", limit + run, "--udp", f"127.0.0.1:{free_port}", "--record", str(tmp_path), "--no-web"]
    service = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    try:
        assert service.stderr is not None
        assert any("listening on" in line for line in service.stderr)
        with square_fleet(free_port) as fleet:
            fly(fleet, 3.0)
            fly(fleet, 9.0, failed=[4])
            last = [m for at_s, m in fleet[3].received if m.get_type() == "GPS_INPUT"]
            assert sum(m.fix_type == 3 for m in last) > 20
        service.send_signal(signal.SIGTERM)
        _, told = service.communicate(timeout=60)
    finally:
        service.kill()
    assert service.returncode == 0
    assert len(re.findall("nothing is being recorded: .*File too large", told)) >= 1
    for path in tmp_path.glob("*.tlog"):
        if path.stat().st_size:
            assert dict(count_damage(path)) == {}


def test_a_disk_that_hangs_is_told_once_and_holds_up_neither_the_flight_nor_its_end(free_port, tmp_path):
    """Every write of the recorder waits for ever, as on a network disk that is gone."""
    hang = "import os, sys, threading; os.pwrite = lambda *_: threading.Event().wait(); "
    run = "from gcs_coloc.cli.main import main; main()"
    command = [sys.executable, "-c", hang + run, "--udp", f"127.0.0.1:{free_port}", "--record", str(tmp_path), "--no-web"]
    with (tmp_path / "log").open("wb") as log:
        service = subprocess.Popen(command, stderr=log, stdout=subprocess.DEVNULL)
    told = "nothing is being recorded: .*the disk has not answered for 5 s; the flight goes on"
    try:
        wait_until(lambda: "listening on" in (tmp_path / "log").read_text())
        with square_fleet(free_port) as fleet:
            fly(fleet, 2.0)
            fly(fleet, 60.0, failed=[4], until=lambda: re.search(told, (tmp_path / "log").read_text()) is not None)
            before = len(fleet[3].of("GPS_INPUT"))
            fly(fleet, 4.0, failed=[4])
            assert len(fleet[3].of("GPS_INPUT")) - before >= 28  # of 40
            service.send_signal(signal.SIGTERM)
            fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
            assert service.poll() == 0
            assert fleet[3].of("GPS_INPUT")[-1].fix_type == 1
    finally:
        service.kill()
        service.wait()
    assert len(re.findall(told, (tmp_path / "log").read_text())) == 1


def count_damage(path: Path):
    log = TlogReader(path)
    assert list(log)
    return log.counts


def test_a_directory_that_cannot_be_written_to_is_one_line(free_port, tmp_path):
    occupied = tmp_path / "file"
    occupied.write_text("")
    done = gcs_coloc("--udp", f"127.0.0.1:{free_port}", "--record", occupied, "--no-web")
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1
    assert f"--record {occupied}: cannot be written to" in done.stderr


def test_a_link_that_cannot_be_opened_leaves_no_recording_behind(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        where = f"127.0.0.1:{other.getsockname()[1]}"
        done = gcs_coloc("--udp", where, "--record", tmp_path, "--no-web")
    assert done.returncode == 1
    assert where in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_record_is_eight_bytes_of_time_and_the_frame(flown):
    data = only(flown, "tlog").read_bytes()
    (first_us,) = struct.unpack_from(">Q", data)
    assert 1.7e15 < first_us < 4e15
    assert data[8] == 0xFD
