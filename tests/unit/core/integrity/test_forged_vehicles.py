"""Forged vehicles from one address place nobody; a router with a whole fleet behind it goes on working."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from functools import lru_cache
from math import cos, pi, sin

import numpy as np
import pytest

from bench.integrity_flights import DENIED, ORIGIN, STEP_S, Flight, Scenario, error_and_bound_m, fresh_engine
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import FromVehicle, GlobalPosition, GpsReceiver, PeerRange, TimeBase

SOUND = (1, 2, 3, 4, DENIED)
FORGED = (11, 12, 13, 14, 15, 16)
PULL_M = np.array((150.0, 0.0, 0.0))
APPEAR_S, FLOWN_S = 15.0, 23.0
"""Believed, they pull it beyond twice its bound within seven seconds."""


def forged(flight: Flight, t: float) -> Iterator[FromVehicle]:
    """Six vehicles on a circle whose ranges put the denied vehicle 150 m east of where it is, all stated to 0.3 m."""
    places = {v: np.array((400.0 * cos(v * pi / 3), 400.0 * sin(v * pi / 3), 120.0)) for v in FORGED}
    for sysid, place in places.items():
        lat, lon, alt = ORIGIN.geodetic_from_enu(*map(float, place))
        yield GpsReceiver(sysid, t, 0, 3, lat, lon, alt, 14, 0.6, 0.3, 0.3, 0.05, t)
        yield GlobalPosition(sysid, t, t, lat, lon, alt, 0.0, 0.0, 0.0)
        for peer in (*SOUND, *FORGED):
            if peer != sysid:
                there = places[peer] if peer in places else flight.courses[peer].at(t)[0] + (peer == DENIED) * PULL_M
                range_m = float(np.linalg.norm(there - place))
                yield PeerRange(sysid, t, peer, range_m, 0.3, t, TimeBase.BOOT, None, None, 0)


def routes(sysids: tuple[int, ...], t: float, *, is_shared: bool) -> Iterator[RouteReport]:
    for sysid in sysids:
        others = tuple(other for other in sysids if other != sysid)
        yield RouteReport(sysid, t, RouteBlock.SHARED_ADDRESS, others) if is_shared else RouteReport(sysid, t, None)


Flown = tuple[Engine, Flight, list[tuple[float, float]]]


def at_the_start() -> Flown:
    return fresh_engine(), Flight(Scenario(), 3), []


@lru_cache
def before_any_appears(*, behind_router: bool) -> bytes:
    """The same whoever appears then: flown once, and pickled for all to go on from."""
    flown = at_the_start()
    go_on(flown, 0.0, APPEAR_S, behind_router=behind_router, forged_from_s=FLOWN_S, trusted=False)
    return pickle.dumps(flown, pickle.HIGHEST_PROTOCOL)


def fly(*, behind_router: bool, forged_from_s: float, trusted: bool = False) -> list[tuple[float, float]]:
    """Fly one draw; return error and bound of every fix. `trusted`: the operator declares the forged ones healthy."""
    begun_s = APPEAR_S if forged_from_s >= APPEAR_S else 0.0
    flown = pickle.loads(before_any_appears(behind_router=behind_router)) if begun_s else at_the_start()
    go_on(flown, begun_s, FLOWN_S, behind_router=behind_router, forged_from_s=forged_from_s, trusted=trusted)
    return flown[-1]


def go_on(flown: Flown, from_s: float, to_s: float, *, behind_router: bool, forged_from_s: float, trusted: bool) -> None:
    engine, flight, found = flown
    for step in range(round(from_s / STEP_S), round(to_s / STEP_S)):
        t = step * STEP_S
        is_attacked = t >= forged_from_s
        for message in (*flight.messages(t), *(forged(flight, t) if is_attacked else ())):
            engine.receive(message)
        if step % 5 == 0:
            together = (*SOUND, *FORGED) if is_attacked else SOUND
            for report in routes(together if behind_router else SOUND, t, is_shared=behind_router):
                engine.receive(report)
            for report in routes(FORGED, t, is_shared=True) if is_attacked and not behind_router else ():
                engine.receive(report)
        if trusted and is_attacked:
            for sysid in FORGED:
                engine.receive(OperatorCommand(sysid, t, GpsOverride.HEALTHY))
        engine.poll(t)
        fix = error_and_bound_m(engine, flight, t) if t > 10.0 else None
        if fix is not None:
            found.append(fix)


@pytest.mark.parametrize("behind_router", [False, True])
def test_six_that_appear_in_flight_change_no_estimate(behind_router):
    assert fly(behind_router=behind_router, forged_from_s=APPEAR_S) == fly(behind_router=behind_router, forged_from_s=FLOWN_S)


def test_six_that_are_there_from_the_start_pull_no_fix_beyond_its_bound():
    found = fly(behind_router=False, forged_from_s=0.0)
    assert len(found) > 60
    assert all(error_m <= bound_m for error_m, bound_m in found)


def test_the_forged_ranges_would_pull_it_away_if_they_were_believed():
    """Without it the tests above would hold of ranges that do no harm."""
    assert max(error_m / bound_m for error_m, bound_m in fly(behind_router=False, forged_from_s=APPEAR_S, trusted=True)) > 2.0


def latecomer(flight: Flight, t: float, off_m: float) -> Iterator[FromVehicle]:
    """Vehicle 5 on the course of a circle, which reports itself `off_m` off, and what 1 and 2 measure to it."""
    place = np.array((300.0 * cos(0.05 * t), 300.0 * sin(0.05 * t), 100.0))
    lat, lon, alt = ORIGIN.geodetic_from_enu(*map(float, place + np.array((off_m, 0.0, 0.0))))
    yield GpsReceiver(5, t, 0, 3, lat, lon, alt, 12, 0.9, 1.5, 1.5, 0.2, t)
    yield GlobalPosition(5, t, t, lat, lon, alt, 15.0 * cos(0.05 * t), -15.0 * sin(0.05 * t), 0.0)
    for peer in (1, 2):
        range_m = float(np.linalg.norm(flight.courses[peer].at(t)[0] - place))
        yield PeerRange(peer, t, 5, range_m, 1.0, t, TimeBase.BOOT, None, None, 0)


def flown_with_latecomer(off_m: float) -> Engine:
    engine, flight = fresh_engine(), Flight(Scenario(lost=False, gps_sigma_m=0.5), 1)
    for step in range(round(30.0 / STEP_S)):
        t = step * STEP_S
        late = t >= 15.0
        for message in (*flight.messages(t), *(latecomer(flight, t, off_m) if late else ())):
            engine.receive(message)
        if step % 5 == 0:
            for report in routes((*SOUND, 5) if late else SOUND, t, is_shared=True):
                engine.receive(report)
        engine.poll(t)
    return engine


def test_a_latecomer_behind_the_router_is_evidence_once_known_vehicles_measure_it_where_it_says():
    assert flown_with_latecomer(0.0).proven.is_proven(5)


def test_one_that_is_measured_elsewhere_than_it_says_stays_none():
    engine = flown_with_latecomer(80.0)
    assert not engine.proven.is_proven(5)
    assert all(engine.proven.is_proven(sysid) for sysid in SOUND)
