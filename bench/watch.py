"""`gcs-coloc watch` with many fleets on a real broker and one page open: its CPU, and how old the page is."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion
from websockets.sync.client import ClientConnection, connect

from bench.figures import Figure
from bench.free_ports import free_port
from bench.service_cpu import cpu_s
from gcs_coloc.sinks.fleet_overview import FleetOverview, VehicleOverview
from gcs_coloc.sinks.mqtt_models import FleetStatus

_FLEETS, _VEHICLES = 20, 10
_CPU_GOAL, _AGE_GOAL_S = 0.15, 2.0
_SETTLE_S = 5.0
_REASON = "GPS failed: no 3D fix: fix type 1. Located within 7 m (95 %), protection level 21 m; sending 3D fix"
_GIVE_UP_S = 30.0


def measure(quick: bool) -> list[Figure]:
    """Each fleet tells of itself once a second, as services do unless told; the page acknowledges every picture."""
    measured_s = 10.0 if quick else 60.0
    with (
        tempfile.TemporaryDirectory() as directory,
        _broker() as port,
        _publishing(port),
        _watch(port, Path(directory) / "log") as (process, address),
        connect(f"ws://{address}/live") as page,
    ):
        _ages_s(page, _SETTLE_S)
        before_s, began_s = cpu_s(process.pid), time.monotonic()
        ages_s = _ages_s(page, measured_s)
        share = (cpu_s(process.pid) - before_s) / (time.monotonic() - began_s)
    what = f"{_FLEETS} fleets of {_VEHICLES}, one page open"
    return [
        Figure(f"CPU, {what}", f"{share:.1%} of a core", f"<= {_CPU_GOAL:.0%}", share <= _CPU_GOAL),
        Figure(
            f"age of what the page shows, {what}",
            f"{sorted(ages_s)[len(ages_s) // 2]:.2f} s (median), {max(ages_s):.2f} s at most",
            f"<= {_AGE_GOAL_S:g} s",
            max(ages_s) <= _AGE_GOAL_S,
        ),
    ]


def _ages_s(page: ClientConnection, for_s: float) -> list[float]:
    """How old each fleet on the page is at worst: just before the next picture takes its place."""
    ages_s: list[float] = []
    shown: list[float] = []
    end_s = time.monotonic() + for_s
    while time.monotonic() < end_s:
        picture = json.loads(page.recv(_GIVE_UP_S))
        if picture["kind"] != "fleets":
            continue
        now_s = time.time()
        ages_s += [now_s - at_s for at_s in shown]
        page.send("shown")
        shown = [fleet["written_unix_s"] for fleet in picture["fleets"] if fleet["presence"] == "live"]
    if len(shown) != _FLEETS:
        raise RuntimeError(f"{len(shown)} of {_FLEETS} fleets are live on the page")
    return ages_s


@contextlib.contextmanager
def _broker() -> Iterator[int]:
    program = shutil.which("mosquitto", path=os.environ.get("PATH", "") + os.pathsep + "/usr/sbin")
    if program is None:
        raise RuntimeError("mosquitto is not installed: sh tools/install-test-tools")
    port = free_port(socket.SOCK_STREAM)
    process = subprocess.Popen([program, "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield port
    finally:
        process.terminate()
        process.wait()


@contextlib.contextmanager
def _watch(port: int, log: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    command = [sys.executable, "-m", "gcs_coloc", "watch", "--mqtt", f"127.0.0.1:{port}", "--web", "127.0.0.1:0"]
    with log.open("wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out)
    try:
        end_s = time.monotonic() + _GIVE_UP_S
        while (found := re.search(r"web page: http://(\S+)/", log.read_text())) is None:
            if process.poll() is not None or time.monotonic() > end_s:
                raise RuntimeError(log.read_text())
            time.sleep(0.05)
        yield process, found.group(1)
    finally:
        process.terminate()
        process.wait()


@contextlib.contextmanager
def _publishing(port: int) -> Iterator[None]:
    """The fleets' messages, spread over each second, from a thread of this process."""
    client = paho.Client(CallbackAPIVersion.VERSION2)
    end_s, ended = time.monotonic() + _GIVE_UP_S, threading.Event()
    while True:
        try:
            client.connect("127.0.0.1", port)
            break
        except ConnectionRefusedError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.05)
    client.loop_start()
    thread = threading.Thread(target=_publish, args=(client, ended), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        client.disconnect()
        client.loop_stop()


def _publish(client: paho.Client, ended: threading.Event) -> None:
    began_s, number = time.monotonic(), 0
    while not ended.wait(max(began_s + number / _FLEETS - time.monotonic(), 0.0)):
        at_s, fleet = time.time(), number % _FLEETS
        base = f"gcs-coloc/v2/fleet-{fleet}"
        sysids = tuple(range(1, _VEHICLES + 1))
        state = FleetStatus(at_unix_s=at_s, online=True, estimator="fleet", vehicles=sysids, refused={}, outs=())
        vehicles = tuple(_vehicle(sysid, at_s) for sysid in sysids)
        told = FleetOverview(
            at_unix_s=at_s, at_s=at_s, every_s=1.0, host=f"host-{fleet // 4}", estimator="fleet", vehicles=vehicles, alarms=()
        )
        client.publish(f"{base}/status", state.model_dump_json(), retain=True)
        client.publish(f"{base}/overview", told.model_dump_json(), retain=True)
        number += 1


def _vehicle(sysid: int, at_s: float) -> VehicleOverview:
    is_denied = sysid % 4 == 0
    return VehicleOverview(
        sysid=sysid,
        name=f"Kite {sysid}",
        light="caution" if is_denied else "good",
        reason=_REASON if is_denied else "GPS healthy: fix type 3, 10 satellites",
        gps_state="failed" if is_denied else "healthy",
        age_s=0.1,
        lat_deg=47.0 + at_s % 100.0 * 1e-4,
        lon_deg=8.0 + sysid * 1e-3,
        alt_msl_m=500.0,
        bound_95_m=6.6,
        hpl_m=21.3,
        aiding="sending 3D fix" if is_denied else "off",
        aiding_has_fix=is_denied,
    )
