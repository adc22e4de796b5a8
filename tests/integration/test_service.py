"""The service as a process on real UDP sockets, against vehicles that pymavlink packs."""

from __future__ import annotations

import contextlib
import math
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest
from command_line import gcs_coloc
from vehicles import LAT, LON, M_PER_DEG_LAT, M_PER_DEG_LON, fly, square_fleet

pytestmark = pytest.mark.integration


def located(vehicle) -> bool:
    return sum(m.fix_type == 3 for m in vehicle.of("GPS_INPUT")) >= 15


def horizontal_error_m(message, enu_m) -> float:
    east, north = (message.lon / 1e7 - LON) * M_PER_DEG_LON, (message.lat / 1e7 - LAT) * M_PER_DEG_LAT
    return math.hypot(east - enu_m[0], north - enu_m[1])


def test_a_vehicle_that_loses_its_gps_is_located_and_nobody_else_gets_anything(start_service, free_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}")
    with square_fleet(free_port) as fleet:
        fly(fleet, 3.0)
        assert not any(v.of("GPS_INPUT") for v in fleet)
        fly(fleet, 60.0, failed=[4], until=lambda: located(fleet[3]))
        fixes = [m for m in fleet[3].of("GPS_INPUT") if m.fix_type == 3]
        assert len(fixes) >= 15
        for fix in fixes:
            # 4 sigma of a filtered position from GPS of 0.8 m and ranges of 0.5 m, which are exact here but for latitude scale.
            assert horizontal_error_m(fix, fleet[3].enu_m) < 4.0
            assert abs(fix.alt - (500.0 + 120.0)) < 5.0
            assert (fix.gps_id, fix.ignore_flags, fix.satellites_visible) == (1, 16, 7)  # vertical velocity
            assert math.hypot(fix.vn, fix.ve) < 4 * fix.speed_accuracy + 0.1
            assert fix.time_week > 2300
        assert not any(v.of("GPS_INPUT") for v in fleet[:3])
        assert {m.get_srcSystem() for m in fleet[3].of("GPS_INPUT")} == {254}
        assert fleet[0].of("HEARTBEAT")

        fleet[3].received.clear()
        service.send_signal(signal.SIGTERM)
        fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
        assert service.wait(60) == 0
        assert [m.fix_type for m in fleet[3].of("GPS_INPUT")][-1] == 1


@contextlib.contextmanager
def started_ignoring(ignored: signal.Signals | None, port: int) -> Iterator[subprocess.Popen[str]]:
    """The service, listening, started by a program that ignores this signal and no other."""

    def prepare() -> None:
        for sign in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
            signal.signal(sign, signal.SIG_IGN if sign is ignored else signal.SIG_DFL)

    command = [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", "--no-web"]
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, preexec_fn=prepare, text=True, **streams) as process:
        assert process.stderr is not None
        next(line for line in process.stderr if "listening on" in line)
        try:
            yield process
        finally:
            process.kill()


# A script's job in the background ignores SIGINT from the start.
@pytest.mark.parametrize(
    ("ignored", "sent"), [(None, signal.SIGHUP), (signal.SIGINT, signal.SIGINT), (signal.SIGTERM, signal.SIGTERM)]
)
def test_a_signal_ends_the_service_however_it_was_started(ignored, sent, free_port):
    with started_ignoring(ignored, free_port) as service:
        service.send_signal(sent)
        assert service.wait(60) == 0


def test_under_nohup_the_flight_goes_on_when_the_terminal_closes(free_port):
    with started_ignoring(signal.SIGHUP, free_port) as service, square_fleet(free_port) as fleet:
        service.send_signal(signal.SIGHUP)
        fly(fleet, 60.0, until=lambda: bool(fleet[0].of("HEARTBEAT")))
        assert fleet[0].of("HEARTBEAT")
        service.send_signal(signal.SIGTERM)
        assert service.wait(60) == 0


def test_two_autopilots_behind_one_address_get_nothing_and_the_operator_is_told(start_service, free_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}")
    with square_fleet(free_port, behind_a_router=True) as fleet:
        fly(fleet, 2.0)
        fly(fleet, 4.0, failed=[4])
        assert not fleet[3].of("GPS_INPUT")
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert service.returncode == 0
    assert "one address" in log
    assert "its own UDP stream" in log


def test_garbage_and_broken_frames_disturb_nobody(start_service, free_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}")
    with square_fleet(free_port) as fleet:
        noise = random.Random(5).randbytes(40) + b"\xfd\xff\x00\x00" + fleet[0].telemetry(0, 3)[0][:-3]
        fly(fleet, 2.0, noise=noise)
        fly(fleet, 60.0, failed=[4], until=lambda: located(fleet[3]), noise=noise)
        assert located(fleet[3])
        assert service.poll() is None


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--nonsense"], 2, "No such option: --nonsense"),
        (["--udp", "nonsense"], 2, "connection string"),
        (["--udp", "70000"], 2, "70000"),
        (["--config", os.devnull], 2, "no link"),
        (["--config", "absent.toml"], 2, "absent.toml"),
        (["--udp", "14550", "--estimator", "absent"], 2, "absent"),
        (["--udp", "14550", "--udp", "127.0.0.1:14550"], 2, "the same place"),
        (["--udp", "14550", "--record", ""], 2, "names no directory"),
        (["doctor", "--udp", "14550", "--aid", "256"], 2, "'--aid'"),
        (["replay", "absent.tlog"], 1, "absent.tlog"),
        (["replay", "pyproject.toml"], 1, "no tlog"),
        (["nonsense"], 2, "nonsense"),
    ],
)
def test_a_users_mistake_ends_in_one_clear_line(arguments, code, words):
    done = gcs_coloc(*arguments)
    assert (done.returncode, done.stdout) == (code, "")
    assert len(done.stderr.strip().splitlines()) == 1
    assert words in done.stderr


@pytest.mark.parametrize(("link", "words"), [("serial:/dev/absent:57600", "/dev/absent"), ("/dev/null", "is no serial device")])
def test_a_device_that_cannot_be_opened_ends_the_service_in_one_clear_line(link, words):
    done = gcs_coloc("--link", link, "--no-web")
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.strip().splitlines()) == 1
    assert words in done.stderr


def test_without_a_word_it_listens_where_ground_stations_do():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        with contextlib.suppress(OSError):  # somebody else has it: just as well
            other.bind(("0.0.0.0", 14550))
        done = gcs_coloc("--no-web")
    assert done.returncode == 1
    assert "udpin:0.0.0.0:14550: port 14550 is in use" in done.stderr


def test_a_port_in_use_is_said_in_one_line_with_the_remedy(free_port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", free_port))
        done = gcs_coloc("--udp", f"127.0.0.1:{free_port}")
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1
    assert f"port {free_port} is in use" in done.stderr
