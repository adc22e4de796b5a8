"""A flood on the service's own socket: what it does to the output of the vehicle that is being aided, beside idle."""

from __future__ import annotations

import subprocess
import sys

from bench.figures import Figure
from bench.free_ports import free_port
from bench.relay import Relay
from bench.service_cpu import SCENARIO, cpu_s, rss_mb, waited_s

_RATE = 20_000
_LIMIT_MS = 200.0
_SETTLE_S = 25.0


def measure(quick: bool) -> list[Figure]:
    """Longest gap between two GPS_INPUT of the aided vehicle, CPU and memory: idle, flooded from one address, and from many.

    How long the service was ready to run and waited for a core tells a slow service from a busy machine.
    """
    each_s = 10.0 if quick else 60.0
    port, relay_port = free_port(), free_port()
    total_s = _SETTLE_S + 3 * each_s + 10.0
    service = subprocess.Popen(
        [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    fakes = subprocess.Popen(
        [sys.executable, "-m", "sitl_fakes", str(SCENARIO), "--target", f"127.0.0.1:{relay_port}", "--duration", str(total_s)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with Relay(relay_port, port) as relay:
            relay.run(_SETTLE_S)
            if service.poll() is not None:
                raise RuntimeError(f"the service ended by itself with exit code {service.returncode}")
            used_s, waiting_s = cpu_s(service.pid), waited_s(service.pid)
            longest_ms = max(relay.run(each_s), default=float("inf"))
            share, waiting = (cpu_s(service.pid) - used_s) / each_s, (waited_s(service.pid) - waiting_s) / each_s
            value = f"{longest_ms:.0f} ms, CPU {share:.0%} of a core, waited for one {waiting:.0%} of the time"
            figures = [Figure("idle: longest gap in GPS_INPUT", value)]
            for addresses in (1, 500):
                figures += _flooded(service.pid, relay, port, each_s, addresses, longest_ms)
        return figures
    finally:
        for child in (fakes, service):
            child.terminate()
            child.wait(10)


def _flooded(pid: int, relay: Relay, port: int, seconds: float, addresses: int, idle_ms: float) -> list[Figure]:
    used_s, waiting_s = cpu_s(pid), waited_s(pid)
    flood = subprocess.Popen(
        [sys.executable, "-m", "bench.flood_sender", str(port), str(_RATE), str(seconds), str(addresses)],
        stdout=subprocess.PIPE,
        text=True,
    )
    gaps_ms = relay.run(seconds / 2)
    # The first half fills tables that have a bound, such as that of vehicles; what grows then has none.
    half_mb = rss_mb(pid)
    gaps_ms += relay.run(seconds / 2)
    growth_mb = rss_mb(pid) - half_mb
    reached = float(flood.communicate(timeout=30)[0])
    share, waiting = (cpu_s(pid) - used_s) / seconds, (waited_s(pid) - waiting_s) / seconds
    longest_ms, per_s = max(gaps_ms, default=float("inf")), len(gaps_ms) / seconds
    name = f"{reached:,.0f}/s from {addresses} address{'es' if addresses > 1 else ''}"
    spent = f"CPU {share:.0%}, waiting {waiting:.0%}"
    return [
        Figure(
            f"{name}: longest gap in GPS_INPUT",
            f"{longest_ms:.0f} ms ({longest_ms / idle_ms:.1f} x idle), {per_s:.1f} a second, {spent}",
            f"<= {_LIMIT_MS:.0f} ms",
            longest_ms <= _LIMIT_MS and per_s >= 9.0,
        ),
        Figure(f"{name}: memory, second half", f"{growth_mb:+.1f} MB of {half_mb:.0f}", "<= 1 %", growth_mb <= half_mb / 100),
    ]
