"""What the whole service costs on live traffic: CPU share and steadiness, beside a mere reader of the same traffic."""

from __future__ import annotations

import os
import select
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.figures import Figure
from bench.free_ports import free_port
from bench.relay import Relay
from sitl_fakes.scenario import SCENARIOS

SCENARIO = SCENARIOS / "uwb.toml"
_READER = """
import sys
from pymavlink import mavutil
from sitl_fakes.scenario import SCENARIOS
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
    intervals_ms: list[float] = []
    service = _run([sys.executable, "-m", "gcs_coloc", "--udp"], settle_s, measured_s, intervals_ms)
    reader = _run([sys.executable, "-c", _READER], settle_s, measured_s, None)
    p50, p99 = np.percentile(np.abs(np.array(intervals_ms) - 100.0), [50, 99])
    return [
        Figure(
            "CPU, four vehicles at 10 Hz, one aided", f"{service.cpu_share:.1%} of a core", "< 10 %", service.cpu_share < 0.10
        ),
        Figure("ratio to a mavutil loop that merely reads", f"{service.cpu_share / reader.cpu_share:.2f}"),
        Figure(
            "resident memory", f"{service.rss_mb:.0f} MB (reader {reader.rss_mb:.0f} MB)", "<= 120 MB", service.rss_mb <= 120.0
        ),
        Figure("GPS_INPUT interval, deviation from 100 ms", f"p50 {p50:.1f} ms, p99 {p99:.1f} ms", "p99 < 20 ms", p99 < 20.0),
    ]


def _run(program: list[str], settle_s: float, measured_s: float, intervals_ms: list[float] | None) -> _Cost:
    port, relay_port = free_port(), free_port()
    argument = f"127.0.0.1:{port}" if "--udp" in program else str(port)
    process = subprocess.Popen([*program, argument], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    total_s = settle_s + measured_s + 3.0
    fakes_target = relay_port if intervals_ms is not None else port
    fakes = subprocess.Popen(
        [sys.executable, "-m", "sitl_fakes", str(SCENARIO), "--target", f"127.0.0.1:{fakes_target}", "--duration", str(total_s)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        if intervals_ms is None:
            _wait(settle_s)
            before = cpu_s(process.pid)
            _wait(measured_s)
        else:
            with Relay(relay_port, port) as relay:
                relay.run(settle_s)
                before = cpu_s(process.pid)
                intervals_ms += relay.run(measured_s)
        return _Cost((cpu_s(process.pid) - before) / measured_s, rss_mb(process.pid))
    finally:
        for child in (fakes, process):
            child.terminate()
            child.wait(10)


def _wait(seconds: float) -> None:
    select.select([], [], [], seconds)


def waited_s(pid: int) -> float:
    """For how long a process was ready to run and waited for a core, s, since its start (Linux: schedstat's second number)."""
    return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[1]) / 1e9


def cpu_s(pid: int) -> float:
    """CPU time of a process in seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def rss_mb(pid: int | str) -> float:
    """Resident memory of a process (its number, or "self") in megabytes."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
