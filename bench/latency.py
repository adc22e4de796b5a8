"""From a range's datagram to the estimate that has it in: CPU time, for a fleet of four with one without GPS."""

from __future__ import annotations

import sys
import time

import numpy as np

from bench.figures import Figure
from bench.flight import Flight
from bench.profile import where_it_goes
from bench.traffic import LOST, WARM_S, Sent, fleet_traffic, message_id_of
from gcs_coloc.mavlink._generated.gcs_coloc import MAVLINK_MSG_ID_PEER_RANGE

_P50_US, _P99_US = 150.0, 500.0


def measure(quick: bool) -> list[Figure]:
    """Each range of the vehicle without GPS: decoding, frame and clocks, gate and filter; other datagrams are not counted."""
    spent_us = _spent_us(20.0 if quick else 120.0)
    p50, p99 = np.percentile(spent_us, [50, 99])
    figure = Figure(
        "latency",
        f"range datagram to estimate, CPU, {len(spent_us)} ranges",
        f"p50 {p50:.0f} us, p99 {p99:.0f} us",
        f"p50 <= {_P50_US:.0f} us, p99 <= {_P99_US:.0f} us",
        bool(p50 <= _P50_US and p99 <= _P99_US),
    )
    if figure.reached:
        return [figure]
    again = [sys.executable, "-m", "bench.latency"]
    return [figure, where_it_goes("latency", again, lambda process: process.wait(), within=_take.__name__)]


def _spent_us(seconds: float) -> list[float]:
    flight = Flight()
    spent_us = []
    for datagram in fleet_traffic(seconds):
        flight.advance(datagram.at_s)
        is_range = message_id_of(datagram.payload) == MAVLINK_MSG_ID_PEER_RANGE and datagram.sysid == LOST
        if not is_range or datagram.at_s < WARM_S:
            flight.receive(*datagram)
            continue
        # What waits to be used is of the datagrams before.
        flight.engine.estimator.take_residuals()
        began_ns = time.process_time_ns()
        _take(flight, datagram)
        spent_us.append((time.process_time_ns() - began_ns) / 1e3)
    return spent_us


def _take(flight: Flight, datagram: Sent) -> None:
    flight.receive(*datagram)
    flight.engine.estimator.take_residuals()


if __name__ == "__main__":
    _spent_us(120.0)
