"""What the operator's side costs: eight pages, MQTT and a recording, beside a bare service on the same traffic meanwhile."""

from __future__ import annotations

import contextlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.figures import Figure
from bench.free_ports import free_port, free_ports
from bench.load import put_under_load, wait_until_bound

PAGES = 8
# The service's grid of deadlines repeats itself after 0.2 s. Over the repeats the traffic falls on it in all these places, for
# both services alike, and the two are never at the same place at the same time.
_LEADS_S = (0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15, 0.175)
_APART = 3
_GRID_S = 0.1
# Reads as a browser does: everything, at once, and acknowledges pictures two by two. What it read goes to its standard output.
_READERS = """
import asyncio, sys
from websockets.asyncio.client import connect
read = 0
async def page(url):
    global read
    shown = False
    async with connect(url, compression=None) as socket:
        async for message in socket:
            read += 1
            if '"kind":"fleet"' in message:
                shown = not shown
                if not shown:
                    await socket.send("both shown")
async def main():
    pages = [asyncio.create_task(page(sys.argv[1])) for _ in range(int(sys.argv[2]))]
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    print(read, sum(task.done() for task in pages), flush=True)
    for task in pages:
        task.cancel()
asyncio.run(main())
"""


@dataclass
class _Arm:
    """One service over all repeats: its delays in ms by what they are of, an array for each repeat; CPU and length in s."""

    delays_ms: dict[str, list[np.ndarray]] = field(default_factory=dict)
    used_s: float = 0.0
    span_s: float = 0.0

    def add(self, fleet: dict[str, list[list[float]]], used_s: float, span_s: float) -> None:
        """Take what one repeat has measured."""
        self.used_s += used_s
        self.span_s += span_s
        sent_s, taken_s = np.array(fleet["ranges_s"]).T
        out_s = np.array(fleet["gps_input_s"])
        # A range that was taken before a deadline was answered is in the answer, as the estimator works off all that it has.
        after = np.searchsorted(out_s, taken_s)
        answered = after < len(out_s)
        for name, delays_s in {
            _TAKEN: taken_s - sent_s,
            _ANSWERED: out_s[after[answered]] - sent_s[answered],
            _LATE: _behind_grid(out_s),
            _JITTER: np.abs(np.diff(out_s) - _GRID_S),
        }.items():
            self.delays_ms.setdefault(name, []).append(delays_s * 1e3)

    def p(self, name: str, percent: float) -> float:
        """A percentile of all repeats together, ms."""
        return float(np.percentile(np.concatenate(self.delays_ms[name]), percent))

    def p99s(self, name: str) -> list[float]:
        """The 99th percentile of each repeat, ms: what it is in one and not in another is noise."""
        return [float(np.percentile(repeat, 99)) for repeat in self.delays_ms[name]]


_TAKEN = "range datagram on the socket to taken by the estimator and handed on"
_ANSWERED = "range datagram on the socket to the first GPS_INPUT that has it in"
_LATE = "GPS_INPUT behind the service's grid"
_JITTER = "GPS_INPUT interval, deviation from 100 ms"


def measure(quick: bool) -> list[Figure]:
    """Both services take the same traffic side by side: whatever else the machine does disturbs both alike."""
    measured_s = 5.0 if quick else 30.0
    mosquitto = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
    if mosquitto is None:
        return [Figure("CPU", "skipped: mosquitto is not installed")]
    arms = {"bare": _Arm(), "observed": _Arm()}
    floor_s = 0.0
    work: list[str] = []
    with tempfile.TemporaryDirectory() as name, _broker(mosquitto, Path(name)) as mqtt_port:
        for repeat in range(len(_LEADS_S)):
            leads_s = [_LEADS_S[repeat], _LEADS_S[(repeat + _APART) % len(_LEADS_S)]]
            did, used_s = _repeat(arms, leads_s, measured_s, Path(name) / str(repeat), mqtt_port)
            work.append(did)
            floor_s += used_s
    bare, observed = arms.values()
    ratio = observed.used_s / observed.span_s / (bare.used_s / bare.span_s)
    shares = f"{observed.used_s / observed.span_s:.1%} and {bare.used_s / bare.span_s:.1%} of a core"
    floor = f"{1.0 + floor_s / bare.used_s:.3f} ({floor_s / bare.span_s:.1%} of a core)"
    return [
        Figure(
            f"CPU with {PAGES} pages, MQTT and recording, over the bare service",
            f"{ratio:.3f} ({shares}; {work[-1]})",
            "< 1.15",
            ratio < 1.15,
        ),
        Figure("the same if they cost no more than their bytes do through the same libraries", floor),
        *(_delay(name, bare, observed) for name in bare.delays_ms),
    ]


def _delay(name: str, bare: _Arm, observed: _Arm) -> Figure:
    noise = bare.p99s(name)
    told = ", ".join(
        f"{arm} {values.p(name, 50):.1f} and {values.p(name, 99):.1f} ms"
        for arm, values in (("bare", bare), ("observed", observed))
    )
    each = ", ".join(f"{p99:.1f}" for p99 in observed.p99s(name))
    return Figure(
        f"{name}, p50 and p99",
        f"{told}: p99 {observed.p(name, 99) / bare.p(name, 99):.2f} times (in each repeat {each})",
        f"p99 within those of the bare one's repeats, {min(noise):.1f} to {max(noise):.1f} ms",
        observed.p(name, 99) <= max(noise),
    )


def _behind_grid(out_s: np.ndarray) -> np.ndarray:
    """How much later each output came than the earliest one lets expect."""
    count = np.round((out_s - out_s[0]) / _GRID_S)
    late_s = out_s - out_s[0] - count * _GRID_S
    return np.asarray(late_s - late_s.min())


def _repeat(arms: dict[str, _Arm], leads_s: Sequence[float], seconds: float, folder: Path, mqtt_port: int) -> tuple[str, float]:
    """Start all anew and measure them; what the observers did meanwhile, in words, and the CPU time of the floor in s."""
    folder.mkdir()
    config = folder / "coloc.toml"
    config.write_text(f'[mqtt]\nhost = "127.0.0.1"\nport = {mqtt_port}\n')
    observers = ["--web", "127.0.0.1:0", "--config", str(config), "--record", str(folder / "flights")]
    ports = free_ports(4)
    heard, outs = ports[:2], ports[2:]
    with contextlib.ExitStack() as stack:
        services = [
            stack.enter_context(_running(folder / f"{number}.log", _service(heard[number], outs[number], arguments)))
            for number, arguments in enumerate((["--no-web"], observers))
        ]
        for service, port in zip(services, heard, strict=True):
            wait_until_bound(service, [port])
        messages = ["-m", "bench.observer_floor", str(mqtt_port), str(folder)]
        floor = stack.enter_context(_running(folder / "floor.log", messages))
        pages, floor_pages = _open_pages(folder / "1.log"), _open_pages(folder / "floor.log")
        fleets = [f"{port},{out},{lead_s}" for port, out, lead_s in zip(heard, outs, leads_s, strict=True)]
        load = put_under_load([*services, floor], fleets, seconds)
        read, closed = (int(word) for word in pages.communicate("", 20)[0].split())
        floor_pages.communicate("", 20)
    *used, floor_s = load.used_s
    for arm, fleet, used_s in zip(arms.values(), load.fleets, used, strict=True):
        arm.add(fleet, used_s, load.span_s)
    recorded = sum(path.stat().st_size for path in (folder / "flights").iterdir())
    return f"{read / PAGES:.0f} messages to a page, {closed} closed, {recorded / 1e6:.1f} MB recorded", floor_s


def _service(port: int, out: int, arguments: list[str]) -> list[str]:
    return ["-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", "--out", f"udp:127.0.0.1:{out}", *arguments]


@contextlib.contextmanager
def _running(log: Path, arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("wb") as written:
        program = subprocess.Popen([sys.executable, *arguments], stdout=written, stderr=written)
    try:
        yield program
    finally:
        program.terminate()
        program.wait(20)


def _open_pages(log: Path) -> subprocess.Popen[str]:
    while not (found := re.search(r"web page: http://(\S+)", log.read_text())):
        threading.Event().wait(0.1)
    command = [sys.executable, "-c", _READERS, f"ws://{found.group(1)}live", str(PAGES)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@contextlib.contextmanager
def _broker(program: str, folder: Path) -> Iterator[int]:
    port = free_port(socket.SOCK_STREAM)
    config = folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nuser root\n")
    with subprocess.Popen([program, "-c", str(config)], stderr=subprocess.DEVNULL) as process:
        try:
            yield port
        finally:
            process.terminate()
