"""What the whole service costs on live traffic: CPU share and steadiness, beside a mere reader of the same traffic."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.figures import Figure

_SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "scenario-uwb.toml"
_READER = """
import sys
from pymavlink import mavutil
link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{sys.argv[1]}", dialect="ardupilotmega")
while True:
    link.recv_match(blocking=True)
"""
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class _Cost:
    cpu_share: float
    rss_mb: float


def measure(quick: bool) -> list[Figure]:
    """Four vehicles at 10 Hz, one of them aided: the service beside a mavutil recv_match loop on the same scenario and seed."""
    settle_s, measured_s = (25.0, 10.0) if quick else (25.0, 30.0)
    jitter_ms: list[float] = []
    service = _run([sys.executable, "-m", "gcs_coloc", "--udp"], settle_s, measured_s, jitter_ms)
    reader = _run([sys.executable, "-c", _READER], settle_s, measured_s, None)
    p50, p99 = np.percentile(jitter_ms, [50, 99])
    return [
        Figure(
            "service",
            "CPU, four vehicles at 10 Hz, one aided",
            f"{service.cpu_share:.1%} of a core",
            "< 10 %",
            service.cpu_share < 0.10,
        ),
        Figure("service", "ratio to a mavutil loop that merely reads", f"{service.cpu_share / reader.cpu_share:.2f}", "", None),
        Figure(
            "service",
            "resident memory",
            f"{service.rss_mb:.0f} MB (reader {reader.rss_mb:.0f} MB)",
            "<= 120 MB",
            service.rss_mb <= 120.0,
        ),
        Figure(
            "service",
            "GPS_INPUT interval, deviation from 100 ms",
            f"p50 {p50:.1f} ms, p99 {p99:.1f} ms",
            "p99 < 20 ms",
            p99 < 20.0,
        ),
    ]


def _run(program: list[str], settle_s: float, measured_s: float, jitter_ms: list[float] | None) -> _Cost:
    port, relay_port = _free_port(), _free_port()
    argument = f"127.0.0.1:{port}" if "--udp" in program else str(port)
    process = subprocess.Popen([*program, argument], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    total_s = settle_s + measured_s + 3.0
    fakes_target = relay_port if jitter_ms is not None else port
    fakes = subprocess.Popen(
        [sys.executable, "-m", "sitl_fakes", str(_SCENARIO), "--target", f"127.0.0.1:{fakes_target}", "--duration", str(total_s)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        if jitter_ms is None:
            _wait(settle_s)
            before = _cpu_s(process.pid)
            _wait(measured_s)
        else:
            _relay(relay_port, port, settle_s, [])
            before = _cpu_s(process.pid)
            _relay(relay_port, port, measured_s, jitter_ms)
        return _Cost((_cpu_s(process.pid) - before) / measured_s, _rss_mb(process.pid))
    finally:
        for child in (fakes, process):
            child.terminate()
            child.wait(10)


def _relay(port: int, service_port: int, seconds: float, jitter_ms: list[float]) -> None:
    """Stand between fakes and service, one socket a vehicle, and note how far GPS_INPUT intervals are from 100 ms."""
    parser = mavlink.MAVLink(None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as front:
        front.bind(("127.0.0.1", port))
        backs: dict[tuple[str, int], socket.socket] = {}
        owners: dict[socket.socket, tuple[str, int]] = {}
        last_s: dict[socket.socket, float] = {}
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            for ready in select.select([front, *owners], [], [], left_s)[0]:
                data, address = ready.recvfrom(4096)
                if ready is front:
                    if address not in backs:
                        back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                        back.bind(("127.0.0.1", 0))
                        backs[address], owners[back] = back, address
                    backs[address].sendto(data, ("127.0.0.1", service_port))
                    continue
                front.sendto(data, owners[ready])
                for message in parser.parse_buffer(data) or []:
                    if message.get_type() == "GPS_INPUT":
                        now_s = time.monotonic()
                        if ready in last_s:
                            jitter_ms.append(abs(now_s - last_s[ready] - 0.1) * 1e3)
                        last_s[ready] = now_s
        for back in owners:
            back.close()


def _wait(seconds: float) -> None:
    select.select([], [], [], seconds)


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _rss_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
