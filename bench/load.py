"""Live traffic of `bench.load_sender` on running programs: what came back, and the CPU time that they used meanwhile."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.service_cpu import cpu_s, waited_s
from bench.traffic import FleetSize

_START_WITHIN_S = 120.0


@dataclass(frozen=True, slots=True)
class Load:
    """`span_s`, and `used_s` and `waited_s` of each process, are of the time after the warm-up.

    `waited_s` is for how long it was ready to run and had no core. `fleets` as `bench.load_sender` tells them.
    """

    messages_per_s: float
    span_s: float
    used_s: list[float]
    waited_s: list[float]
    fleets: list[dict[str, Any]]


def cores() -> tuple[set[int], set[int]]:
    """A core for the program that is measured, and those for the sender of its load; the same where there is only one."""
    first, *others = sorted(os.sched_getaffinity(0), reverse=True)
    return {first}, set(others) or {first}


def put_under_load(
    programs: Sequence[subprocess.Popen[bytes]],
    fleets: Sequence[str],
    seconds: float,
    sender_on: set[int] | None = None,
    size: FleetSize = FleetSize(),  # noqa: B008 - immutable
    workers: Sequence[int] = (),
) -> Load:
    """Send to `fleets` (see `bench.load_sender`) for a time after the warm-up, from the cores `sender_on` (any by default).

    `workers` are further processes that are measured, by their numbers; they stand after the programs.
    RuntimeError where a program ends meanwhile.
    """
    samples: list[tuple[float, list[float], list[float]]] = []
    # To a file: a hundred fleets' output is longer than a pipe holds, and nobody reads until the sender has ended.
    with tempfile.TemporaryFile("w+", encoding="utf-8") as output:
        sender = subprocess.Popen(
            [sys.executable, "-m", "bench.load_sender", str(seconds), f"{size.vehicles},{size.denied}", *fleets], stdout=output
        )
        if sender_on is not None:
            os.sched_setaffinity(sender.pid, sender_on)
        # The sender's preparations come on top of its warm-up; what counts is how much is used from the first look to the end.
        while sender.poll() is None:
            time.sleep(0.25)
            pids = [*(program.pid for program in programs), *workers]
            samples.append((time.monotonic(), [cpu_s(pid) for pid in pids], [waited_s(pid) for pid in pids]))
        output.seek(0)
        told = json.load(output)
    for program in programs:
        if program.poll() is not None:
            raise RuntimeError(f"{_words(program)} ended by itself with {program.returncode}")
    began = min(samples, key=lambda s: abs(s[0] - told["began_s"]))
    ended = min(samples, key=lambda s: abs(s[0] - told["ended_s"]))
    return Load(
        messages_per_s=told["sent"] / (told["ended_s"] - told["began_s"]),
        span_s=ended[0] - began[0],
        used_s=[after_s - before_s for before_s, after_s in zip(began[1], ended[1], strict=True)],
        waited_s=[after_s - before_s for before_s, after_s in zip(began[2], ended[2], strict=True)],
        fleets=told["fleets"],
    )


def wait_until_bound(program: subprocess.Popen[bytes], ports: Sequence[int]) -> None:
    """Wait until the program listens: before that, one of the sender's many sockets might be given one of its ports."""
    wanted = {f"{port:04X}" for port in ports}
    until_s = time.monotonic() + _START_WITHIN_S
    while not wanted <= {line.split()[1].rpartition(":")[2] for line in Path("/proc/net/udp").read_text().splitlines()[1:]}:
        if program.poll() is not None or time.monotonic() > until_s:
            raise RuntimeError(f"{_words(program)} does not listen on its ports")
        time.sleep(0.1)


def _words(program: subprocess.Popen[bytes]) -> str:
    return " ".join(map(str, program.args[:4]))  # type: ignore[index]
