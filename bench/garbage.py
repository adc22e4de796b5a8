"""What Python's garbage collector costs many fleets in one process, with its default thresholds and with the service's."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import time
from functools import partial

from bench.figures import Figure, interleaved
from bench.flight import Flight
from bench.traffic import WARM_S, fleet_traffic
from gcs_coloc.runtime.gc_policy import collect_seldom

_FLEETS = 25
_SECONDS = 4.0


def measure(quick: bool) -> list[Figure]:
    """CPU per message and the longest pause, each in a process of its own, in turn."""
    pauses_ms: dict[str, list[float]] = {"default": [], "ours": []}

    def run(how: str) -> float:
        told = json.loads(subprocess.run([sys.executable, "-m", "bench.garbage", how], capture_output=True, check=True).stdout)
        pauses_ms[how].append(told["longest_ms"])
        return float(told["us"])

    cost_us = interleaved({how: partial(run, how) for how in pauses_ms}, 1 if quick else 5)
    longest = {how: max(values) for how, values in pauses_ms.items()}
    ratio = cost_us["default"] / cost_us["ours"]
    return [
        Figure(
            "garbage",
            f"{_FLEETS} fleets of four: Python's default thresholds beside ours, CPU per message",
            f"{cost_us['default']:.0f} us beside {cost_us['ours']:.0f} us: {ratio:.2f}",
            "> 1",
            ratio > 1.0,
        ),
        Figure("garbage", "longest pause", f"{longest['default']:.0f} ms beside {longest['ours']:.0f} ms", "", None),
    ]


def main() -> None:
    """One run, with the default thresholds or ours; prints CPU in us per message and the longest pause in ms as JSON."""
    traffic = fleet_traffic(_SECONDS)
    flights = [Flight() for _ in range(_FLEETS)]
    if sys.argv[1] == "ours":
        collect_seldom()
    warm = sum(sent.at_s < WARM_S for sent in traffic)
    for sent in traffic[:warm]:
        for flight in flights:
            flight.take((sent,))
    pauses_s, began_s = [0.0], [0.0]

    def watch(phase: str, _: object) -> None:
        if phase == "start":
            began_s[0] = time.process_time()
        else:
            pauses_s.append(time.process_time() - began_s[0])

    gc.callbacks.append(watch)
    start_s = time.process_time()
    for sent in traffic[warm:]:
        for flight in flights:
            flight.take((sent,))
    us = (time.process_time() - start_s) / (len(traffic) - warm) / _FLEETS * 1e6
    print(json.dumps({"us": us, "longest_ms": max(pauses_s) * 1e3}))


if __name__ == "__main__":
    main()
