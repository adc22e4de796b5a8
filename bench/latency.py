"""From a range's datagram to the estimate that has it in: CPU time, for a fleet of four with one without GPS."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bench.figures import Figure
from bench.flight import Flight
from bench.profile import where_it_goes
from bench.traffic import LOST, WARM_S, Sent, fleet_traffic, message_id_of
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.ekf.state import JointState
from gcs_coloc.mavlink._generated.gcs_coloc import MAVLINK_MSG_ID_PEER_RANGE

_P50_US, _P99_US = 150.0, 500.0
_ALGEBRA = ("propagate", "predict_measurement", "predict_block_measurement", "correct_scalar", "decay")


def measure(quick: bool) -> list[Figure]:
    """Each range of the vehicle without GPS: decoding, frame and clocks, gate and filter; other datagrams are not counted."""
    seconds = 20.0 if quick else 120.0
    spent_us = _spent_us(seconds)
    with _algebra_timed() as spent_ns:
        algebra_us = np.median(_spent_us(seconds, lambda: spent_ns[0] / 1e3)[:, 2])
    p50, p99 = np.percentile(spent_us[:, 0], [50, 99])
    before_us = np.median(spent_us[:, 1])
    figure = Figure(
        f"range datagram to estimate, CPU, {len(spent_us)} ranges",
        f"p50 {p50:.0f} us, p99 {p99:.0f} us",
        f"p50 <= {_P50_US:.0f} us, p99 <= {_P99_US:.0f} us",
        bool(p50 <= _P50_US and p99 <= _P99_US),
    )
    if figure.reached:
        return [figure]
    floor = (
        f"p50 {before_us + algebra_us:.0f} us: decoding and engine {before_us:.0f}, "
        f"the filter's linear algebra alone {algebra_us:.0f}; the rest is Python of the filter"
    )
    again = [sys.executable, "-m", "bench.latency"]
    return [
        figure,
        Figure("its floor", floor),
        where_it_goes(again, lambda process: process.wait(), within=_receive.__name__),
    ]


def _spent_us(seconds: float, also: Callable[[], float] = lambda: 0.0) -> FloatArray:
    """Return for each range (N, 3) the CPU time of all of it, of what comes before the filter, and how much `also` grew, us."""
    flight = Flight()
    spent_us = []
    for datagram in fleet_traffic(seconds):
        flight.advance(datagram.at_s)
        is_range = message_id_of(datagram.payload) == MAVLINK_MSG_ID_PEER_RANGE and datagram.sysid == LOST
        if not is_range or datagram.at_s < WARM_S:
            flight.receive(*datagram)
            continue
        # What waits to be used is of the datagrams before.
        flight.engine.estimator.drain_residuals()
        also_before, began_ns = also(), time.process_time_ns()
        reached_filter_ns = _receive(flight, datagram)
        ended_ns = time.process_time_ns()
        spent_us.append(((ended_ns - began_ns) / 1e3, (reached_filter_ns - began_ns) / 1e3, also() - also_before))
    return np.array(spent_us)


def _receive(flight: Flight, datagram: Sent) -> int:
    flight.receive(*datagram)
    reached_filter_ns = time.process_time_ns()
    flight.engine.estimator.drain_residuals()
    return reached_filter_ns


@contextmanager
def _algebra_timed() -> Iterator[list[int]]:
    """Time the calls of the filter's linear algebra: the list's one value is the sum so far, ns."""
    spent_ns, plain = [0], {name: getattr(JointState, name) for name in _ALGEBRA}

    def timed(call: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            began_ns = time.perf_counter_ns()
            answer = call(*arguments, **named)
            spent_ns[0] += time.perf_counter_ns() - began_ns
            return answer

        return run

    for name, call in plain.items():
        setattr(JointState, name, timed(call))
    try:
        yield spent_ns
    finally:
        for name, call in plain.items():
            setattr(JointState, name, call)


if __name__ == "__main__":
    _spent_us(120.0)
