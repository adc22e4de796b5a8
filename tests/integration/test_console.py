"""Who does not read what the service writes, a stopped terminal or a full pipe, stops neither the flight nor its end."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading

import pytest
from vehicles import fly, square_fleet

pytestmark = pytest.mark.integration

CTRL_S = b"\x13"


class Terminal:
    """A pseudo-terminal of 120 columns; what is written to it is collected in the background."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        self.seen = b""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        while True:
            try:
                self.seen += os.read(self.master, 65536)
            except OSError:
                return

    def serve(self, port: int) -> subprocess.Popen[bytes]:
        """The service on this terminal, with vehicle 4 declared failed."""
        service = subprocess.Popen(
            [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", "--no-web", "--failed", "4"],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
        )
        os.close(self.slave)
        return service

    def last_line(self) -> str:
        return re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", self.seen.decode(errors="replace")).splitlines()[-1]

    def type(self, keys: bytes) -> None:
        os.write(self.master, keys)


def test_a_stopped_terminal_stops_neither_the_flight_nor_its_end(free_port):
    terminal = Terminal()
    service = terminal.serve(free_port)
    try:
        with square_fleet(free_port) as fleet:
            lost = fleet[3]
            fly(fleet, 60.0, failed=[4], until=lambda: len(lost.of("GPS_INPUT")) > 10 and b"sending 3D fix" in terminal.seen)
            assert b"sending 3D fix" in terminal.seen
            assert b"operator: GPS failed" in terminal.seen
            terminal.type(CTRL_S)
            fly(fleet, 2.0, failed=[4])
            before, shown = len(lost.of("GPS_INPUT")), len(terminal.seen)
            # Enough for many tables, and for log lines: vehicle 1 loses its GPS as well.
            fly(fleet, 6.0, failed=[1, 4])
            assert len(terminal.seen) == shown
            assert len(lost.of("GPS_INPUT")) - before >= 40  # of 60; a service that waits for its terminal sends none
            service.send_signal(signal.SIGTERM)
            fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
            assert service.poll() == 0
            assert lost.of("GPS_INPUT")[-1].fix_type == 1
    finally:
        service.kill()
        service.wait()
        os.close(terminal.master)


def test_the_last_line_on_a_terminal_says_whose_aid_has_ended(free_port):
    end = "aiding of vehicle 4 ended: the service ends"
    terminal = Terminal()
    service = terminal.serve(free_port)
    try:
        with square_fleet(free_port) as fleet:
            lost = fleet[3]
            fly(fleet, 60.0, failed=[4], until=lambda: len(lost.of("GPS_INPUT")) > 10)
            service.send_signal(signal.SIGINT)
            fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
            assert service.poll() == 0
            fly(fleet, 60.0, failed=[4], until=lambda: end in terminal.last_line())
        assert end in terminal.last_line()
    finally:
        service.kill()
        service.wait()
        os.close(terminal.master)


def test_a_log_that_nobody_reads_stops_neither_the_flight_nor_its_end(free_port):
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(1024))
    os.set_blocking(writing, True)
    command = [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{free_port}", "--no-web"]
    service = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=writing)
    os.close(writing)
    try:
        with square_fleet(free_port) as fleet:
            lost = fleet[3]
            fly(fleet, 60.0, failed=[], until=lambda: bool(lost.received))
            fly(fleet, 60.0, failed=[4], until=lambda: sum(m.fix_type == 3 for m in lost.of("GPS_INPUT")) > 20)
            assert sum(m.fix_type == 3 for m in lost.of("GPS_INPUT")) > 20
            service.send_signal(signal.SIGTERM)
            fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
            assert service.poll() == 0
            assert lost.of("GPS_INPUT")[-1].fix_type == 1
    finally:
        service.kill()
        service.wait()
        os.close(reading)


def log_in() -> None:
    """Make stdin the process's own terminal, as a login shell's; whoever runs the tests may do so under nohup."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_a_terminal_that_is_closed_ends_the_flight_in_order(free_port):
    master, slave = pty.openpty()
    service = subprocess.Popen(
        [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{free_port}", "--no-web", "--failed", "4"],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        preexec_fn=log_in,
    )
    os.close(slave)
    try:
        with square_fleet(free_port) as fleet:
            lost = fleet[3]
            fly(fleet, 60.0, failed=[4], until=lambda: len(lost.of("GPS_INPUT")) > 10)
            assert len(lost.of("GPS_INPUT")) > 10
            os.close(master)
            fly(fleet, 60.0, failed=[4], until=lambda: service.poll() is not None)
            assert service.wait(60) == 0
            assert lost.of("GPS_INPUT")[-1].fix_type == 1
    finally:
        service.kill()
        service.wait()
