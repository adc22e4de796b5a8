"""A fleet that ranges fixed stations with the numbers of vehicles, flown by hand-moved time."""

from __future__ import annotations

from math import dist

import numpy as np
from engine_flights import ALT, LAT, LON, M_PER_DEGREE_EAST, telemetry

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.core.stations.stations import Station, StationPosition

FRAME = LocalFrame(LAT, LON, ALT)
PLACES = {1: (300.0, 900.0, 0.0), 2: (900.0, 100.0, 10.0), 3: (1500.0, 800.0, 5.0), 0: (700.0, 1200.0, 20.0)}
"""Stations with the numbers of vehicles, and one with number 0: east, north, up, m."""
SIGMA_M = 0.3


def configured(sigma_m=1.0, moved=None) -> tuple[Station, ...]:
    found = []
    for station_id, (e, n, u) in PLACES.items():
        east_m = e + (moved or {}).get(station_id, 0.0)
        found.append(
            Station(station_id, f"mast {station_id}", StationPosition(*FRAME.geodetic_from_enu(east_m, n, u), sigma_m, sigma_m))
        )
    return tuple(found)


def true_enu_m(sysid: int, t: float):
    return FRAME.enu_from_geodetic(LAT + 0.001 * sysid, LON + 20.0 * t / M_PER_DEGREE_EAST, ALT + 30.0)


def ranges(sysid: int, t: float, rng, station_ids=tuple(PLACES)):
    for station_id in station_ids:
        range_m = dist(true_enu_m(sysid, t), PLACES[station_id]) + rng.normal(0.0, SIGMA_M)
        yield PeerRange(sysid, t, station_node(station_id), range_m, SIGMA_M, t, TimeBase.SERVICE, None, None, 0)


def fly_with_ranges(
    engine, start_s, stop_s, rng, *, failed=(), sysids=(4,), ranging=(4,), station_ids=tuple(PLACES), on_poll=lambda *_: None
):
    out = []
    for step in range(round(start_s * 10), round(stop_s * 10)):
        t = step / 10
        for sysid in sysids:
            for message in telemetry(sysid, t, 1 if sysid in failed else 3):
                engine.receive(message)
        if step % 2 == 0:
            for sysid in ranging:
                for message in ranges(sysid, t, rng, station_ids):
                    engine.receive(message)
        while engine.next_deadline() < t + 0.1:
            now_s = max(engine.next_deadline(), t)
            outputs = engine.poll(now_s)
            on_poll(now_s, outputs)
            out.extend((now_s, o) for o in outputs)
    return out


def error_m(engine, t):
    estimate = engine.estimate(4, t)
    where = engine.frame.geodetic_from_enu(*estimate.position_enu_m)
    return dist(FRAME.enu_from_geodetic(*where)[:2], true_enu_m(4, t)[:2]), float(np.sqrt(estimate.covariance[0, 0]))
