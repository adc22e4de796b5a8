"""The whole service on live traffic of many fleets, beside programs that merely read it: CPU per message, and steadiness."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.figures import Figure, interleaved
from bench.free_ports import free_port, free_ports
from bench.load import cores, put_under_load, wait_until_bound
from bench.profile import where_it_goes
from bench.service_cpu import rss_mb
from bench.traffic import FleetSize

_MAVUTIL = """
import sys
from pymavlink import mavutil
link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{sys.argv[1]}", dialect="ardupilotmega")
while True:
    link.recv_match(blocking=True)
"""
_RECVFROM = """
import socket, sys
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.bind(("127.0.0.1", int(sys.argv[1])))
while True:
    link.recvfrom(65535)
"""
_VEHICLES_A_FLEET = 4
_LARGE = FleetSize(20, 5)
_MOST_JITTER_MS = 20.0
_GOAL_VEHICLES = 400


@dataclass(frozen=True, slots=True)
class _Run:
    """One program on live traffic. `share` is CPU per second, `jitter_ms` the deviations of GPS_INPUT intervals from 100 ms.

    `waited_share` is for how much of the time it was ready to run and another program had the core.
    """

    cpu_us_per_message: float
    share: float
    waited_share: float
    rss_mb: float
    jitter_ms: np.ndarray
    outputs_per_s: float


def measure_throughput(quick: bool) -> list[Figure]:
    """CPU per message of the service and of the readers, in turn, on the traffic of ten fleets of four in real time."""
    fleets, seconds, repeats = (10, 8.0, 1) if quick else (10, 20.0, 3)
    readers = {
        "service": lambda: _service(fleets, seconds).cpu_us_per_message,
        "mavutil": lambda: _reader([sys.executable, "-c", _MAVUTIL], fleets, seconds),
        "recvfrom": lambda: _reader([sys.executable, "-c", _RECVFROM], fleets, seconds),
    }
    mavproxy = shutil.which("mavproxy.py", path=str(Path(sys.executable).parent))
    if mavproxy is not None:
        readers["MAVProxy"] = lambda: _mavproxy(mavproxy, fleets, seconds)
    cost_us = interleaved(readers, repeats)
    ratio = cost_us["mavutil"] / cost_us["service"]
    return [
        Figure(
            f"service, {fleets} fleets of four, one of each without GPS, messages per CPU second",
            f"{1e6 / cost_us['service']:,.0f} ({cost_us['service']:.0f} us each), {ratio:.2f} x a mavutil loop that merely reads",
            ">= 1.0 x",
            ratio >= 1.0,
        ),
        *(
            Figure(f"{name} on the same datagrams", f"{1e6 / cost:,.0f} ({cost:.1f} us each)")
            for name, cost in cost_us.items()
            if name != "service"
        ),
        *([] if mavproxy is not None else [Figure("MAVProxy on the same datagrams", "not installed")]),
        *([] if ratio >= 1.0 else [_where_it_goes(fleets, seconds)]),
    ]


def measure_vehicles(quick: bool) -> list[Figure]:
    """How many vehicles one process serves in real time on one core, one in four without GPS; the load comes from another."""
    seconds = 10.0 if quick else 30.0
    figures = []
    for vehicles in (100, 150, 200, _GOAL_VEHICLES):
        run = _service(vehicles // _VEHICLES_A_FLEET, seconds)
        p50, p99 = np.percentile(run.jitter_ms, [50, 99]) if len(run.jitter_ms) else (np.inf, np.inf)
        expected = vehicles / _VEHICLES_A_FLEET * 10.0
        steady = bool(p99 < _MOST_JITTER_MS and run.outputs_per_s > 0.98 * expected)
        figures.append(
            Figure(
                f"{vehicles} vehicles in fleets of four, GPS_INPUT interval off 100 ms",
                f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, {run.outputs_per_s:.0f} of {expected:.0f}/s, "
                f"CPU {run.share:.0%}, {run.cpu_us_per_message:.0f} us a message, {run.rss_mb:.0f} MB; "
                f"ready without a core {run.waited_share:.0%} of the time",
                f"p99 < {_MOST_JITTER_MS:.0f} ms" if vehicles == _GOAL_VEHICLES else "",
                steady if vehicles == _GOAL_VEHICLES else None,
            )
        )
    if not figures[-1].reached:
        figures.append(_where_it_goes(_GOAL_VEHICLES // _VEHICLES_A_FLEET, seconds))
    return figures


def measure_processes(quick: bool) -> list[Figure]:
    """What a fleet of 20, 5 of them denied, costs in one worker process, and what two cost in two, the supervisor included."""
    seconds, repeats = (8.0, 1) if quick else (20.0, 3)
    came: dict[int, list[float]] = {1: [], 2: []}

    def share_of(fleets: int) -> float:
        share, outputs_per_s = _worker_processes(fleets, seconds)
        came[fleets].append(outputs_per_s)
        return share

    one, two = interleaved({"one": lambda: share_of(1), "two": lambda: share_of(2)}, repeats).values()
    linearity, outputs = two / (2.0 * one), {fleets: float(np.median(of_each)) for fleets, of_each in came.items()}
    figures = [
        Figure(
            f"vehicles per core, {fleets} process(es), each a fleet of {_LARGE.vehicles} with {_LARGE.denied} denied",
            f"{fleets * _LARGE.vehicles / share:.0f} (CPU {share:.0%} of a core, {outputs[fleets]:.0f} GPS_INPUT/s)",
            f"{fleets * _LARGE.denied * 10} GPS_INPUT/s",
            outputs[fleets] > 0.98 * fleets * _LARGE.denied * 10,
        )
        for fleets, share in ((1, one), (2, two))
    ]
    name = "CPU of two processes over twice that of one"
    return [*figures, Figure(name, f"{linearity:.2f}", "<= 1.10", linearity <= 1.10)]


def _worker_processes(fleets: int, seconds: float) -> tuple[float, float]:
    """CPU per second of supervisor and workers, and GPS_INPUT per second, for so many fleets in as many processes."""
    ports = free_ports(fleets)
    with _program(ports, '[service]\nprocesses = "per-fleet"\naddress = "0"\n') as program, _running(program) as process:
        wait_until_bound(process, ports)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="ascii").split()
        load = put_under_load([process], [str(port) for port in ports], seconds, size=_LARGE, workers=list(map(int, children)))
        came = sum(len(fleet["gps_input_s"]) for fleet in load.fleets)
        return sum(load.used_s) / load.span_s, came / load.span_s


def _service(fleets: int, seconds: float) -> _Run:
    ports = free_ports(fleets)
    with _program(ports) as program:
        return _under_load(program, ports, seconds)


def _where_it_goes(fleets: int, seconds: float) -> Figure:
    ports = free_ports(fleets)

    def drive(process: subprocess.Popen[bytes]) -> None:
        wait_until_bound(process, ports)
        put_under_load([process], [str(port) for port in ports], seconds)

    with _program(ports) as program:
        return where_it_goes(program, drive, within="BaseEventLoop._run_once")


@contextmanager
def _program(ports: list[int], settings: str = "") -> Iterator[list[str]]:
    """The service's command line for a fleet at each port, with `settings` for all."""
    with tempfile.TemporaryDirectory() as directory:
        config = Path(directory) / "fleets.toml"
        tables = (f'[[fleet]]\nname = "f{n}"\nlinks = ["udpin:127.0.0.1:{port}"]\n' for n, port in enumerate(ports))
        config.write_text(settings + "\n".join(tables))
        yield [sys.executable, "-m", "gcs_coloc", "--config", str(config), "--log-level", "error"]


def _reader(program: list[str], fleets: int, seconds: float) -> float:
    port = free_port()
    return _under_load([*program, str(port)], [port] * fleets, seconds).cpu_us_per_message


def _mavproxy(program: str, fleets: int, seconds: float) -> float:
    port = free_port()
    with tempfile.TemporaryDirectory() as directory:
        command = [program, f"--master=udpin:127.0.0.1:{port}", "--daemon", "--non-interactive", f"--state-basedir={directory}"]
        command += [f"--logfile={directory}/flight.tlog", "--streamrate=-1"]
        return _under_load(command, [port] * fleets, seconds).cpu_us_per_message


def _under_load(program: list[str], ports: list[int], seconds: float) -> _Run:
    core, others = cores()
    with _running(program) as process:
        os.sched_setaffinity(process.pid, core)
        wait_until_bound(process, ports)
        load = put_under_load([process], [str(port) for port in ports], seconds, sender_on=others)
        intervals_ms = np.concatenate([np.diff(fleet["gps_input_s"]) * 1e3 for fleet in load.fleets])
        share = load.used_s[0] / load.span_s
        return _Run(
            cpu_us_per_message=share / load.messages_per_s * 1e6,
            share=share,
            waited_share=load.waited_s[0] / load.span_s,
            rss_mb=rss_mb(process.pid),
            jitter_ms=np.abs(intervals_ms - 100.0),
            outputs_per_s=len(intervals_ms) / load.span_s,
        )


@contextmanager
def _running(program: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(program, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20)
