"""From the command to the first datagram that is taken: a vehicle's heartbeats are sent until the log tells of it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from bench.figures import Figure
from bench.free_ports import free_port
from bench.service_cpu import cpu_s

_GOAL_S = 1.0
_GIVE_UP_S = 60.0


def measure(quick: bool) -> list[Figure]:
    """The quickest of several starts, by turns with bare ones: what a busy machine adds says nothing of the program."""
    starts, with_page, bare = [], [], []
    for _ in range(3 if quick else 10):
        bare.append(_bare())
        starts.append(_start(["--no-web"]))
        with_page.append(_start(["--web", "127.0.0.1:0"]))
    best_s, cpu, bare_s = min(wall for wall, _ in starts), min(used for _, used in starts), min(bare)
    return [
        Figure(
            "start",
            "to the first datagram taken, without the page",
            f"{best_s:.2f} s (CPU {cpu:.2f} s), {best_s / bare_s:.1f} times importing numpy alone ({bare_s:.2f} s)",
            f"<= {_GOAL_S:.1f} s",
            best_s <= _GOAL_S,
        ),
        Figure(
            "start", "with the page", f"{min(w for w, _ in with_page):.2f} s (CPU {min(u for _, u in with_page):.2f} s)", "", None
        ),
    ]


def _start(arguments: list[str]) -> tuple[float, float]:
    """Wall and CPU seconds of one start."""
    port = free_port()
    frames = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
    began_s = time.monotonic()
    service = subprocess.Popen(
        [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}", *arguments],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
    )
    assert service.stderr is not None
    os.set_blocking(service.stderr.fileno(), False)
    told = b""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            while b"heard for the first time" not in told:
                if time.monotonic() - began_s > _GIVE_UP_S:
                    raise RuntimeError(f"the service did not start: {told.decode()}")
                frames.seq = (frames.seq + 1) & 0xFF
                vehicle.sendto(heartbeat.pack(frames), ("127.0.0.1", port))
                time.sleep(0.005)
                told += service.stderr.read() or b""
        return time.monotonic() - began_s, cpu_s(service.pid)
    finally:
        service.terminate()
        service.communicate(timeout=20)


def _bare() -> float:
    began_s = time.monotonic()
    subprocess.run([sys.executable, "-c", "import numpy"], check=True)
    return time.monotonic() - began_s
