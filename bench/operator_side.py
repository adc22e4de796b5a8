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
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.figures import Figure
from bench.relay import Relay
from bench.service_cpu import SCENARIO, cpu_s, free_port

PAGES = 8
_SETTLE_S = 25.0
# Reads as a browser does: everything, at once. What it read goes to its standard output.
_READERS = """
import asyncio, sys
from websockets.asyncio.client import connect
read = 0
async def page(url):
    global read
    async with connect(url, compression=None) as socket:
        async for _ in socket:
            read += 1
async def main():
    pages = [asyncio.create_task(page(sys.argv[1])) for _ in range(int(sys.argv[2]))]
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    print(read, sum(task.done() for task in pages))
asyncio.run(main())
"""


class _Flight:
    """A service with aircraft of its own, between them a relay that sees every GPS_INPUT."""

    def __init__(self, log: Path, arguments: list[str], seconds: float) -> None:
        self.intervals_ms: list[float] = []
        self.cpu_s = 0.0
        port, front = free_port(), free_port()
        self._relay = Relay(front, port)
        with log.open("wb") as out:
            command = [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", *arguments]
            self._service = subprocess.Popen(command, stdout=out, stderr=out)
        self._fakes = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "sitl_fakes",
                str(SCENARIO),
                "--target",
                f"127.0.0.1:{front}",
                "--duration",
                str(seconds + 10.0),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def fly(self, settle_s: float, measured_s: float) -> None:
        """Fly, and measure the later part."""
        self._relay.run(settle_s)
        before = cpu_s(self._service.pid)
        self.intervals_ms = self._relay.run(measured_s)
        self.cpu_s = cpu_s(self._service.pid) - before

    def end(self) -> None:
        """End service and aircraft."""
        for process in (self._fakes, self._service):
            process.terminate()
            process.wait(20)
        self._relay.__exit__()


def measure(quick: bool) -> list[Figure]:
    """Both services fly the same scenario and seed side by side: whatever else the machine does disturbs both alike."""
    measured_s = 20.0 if quick else 60.0
    mosquitto = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
    if mosquitto is None:
        return [Figure("operator", "CPU", "skipped: mosquitto is not installed", "", None)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with _broker(mosquitto, folder) as mqtt_port:
            config = folder / "coloc.toml"
            config.write_text(f'[mqtt]\nhost = "127.0.0.1"\nport = {mqtt_port}\n')
            seconds = _SETTLE_S + measured_s
            bare = _Flight(folder / "bare.log", ["--no-web"], seconds)
            observed = ["--web", "127.0.0.1:0", "--config", str(config), "--record", str(folder / "flights")]
            full = _Flight(folder / "full.log", observed, seconds)
            try:
                pages = _open_pages(folder / "full.log")
                flights = [threading.Thread(target=flight.fly, args=(_SETTLE_S, measured_s)) for flight in (bare, full)]
                for thread in flights:
                    thread.start()
                for thread in flights:
                    thread.join()
                read, closed = (int(word) for word in pages.communicate("", 20)[0].split())
            finally:
                bare.end()
                full.end()
        recorded = sum(path.stat().st_size for path in (folder / "flights").iterdir())
    ratio = full.cpu_s / bare.cpu_s
    late = {name: np.abs(np.array(flight.intervals_ms) - 100.0) for name, flight in (("bare", bare), ("observed", full))}
    p99 = {name: float(np.percentile(values, 99)) for name, values in late.items()}
    # What the p99 of the bare service is in one quarter of the run and not in another is noise.
    spread = [float(np.percentile(quarter, 99)) for quarter in np.array_split(late["bare"], 4)]
    work = f"{read / PAGES / seconds:.1f} messages/s a page, {closed} closed, {recorded / 1e6:.1f} MB recorded"
    return [
        Figure(
            "operator",
            f"CPU with {PAGES} pages, MQTT and recording, over the bare service",
            f"{ratio:.3f} ({full.cpu_s / measured_s:.1%} and {bare.cpu_s / measured_s:.1%} of a core; {work})",
            "< 1.15",
            ratio < 1.15,
        ),
        Figure(
            "operator",
            "GPS_INPUT interval, deviation from 100 ms, p50 and p99",
            ", ".join(f"{name} {np.percentile(values, 50):.1f} and {p99[name]:.1f} ms" for name, values in late.items()),
            f"p99 within those of the bare one's quarters, {min(spread):.1f} to {max(spread):.1f} ms",
            p99["observed"] <= max(spread),
        ),
    ]


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
