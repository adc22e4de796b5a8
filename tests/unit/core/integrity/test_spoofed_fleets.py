"""Planes in flight whose receivers are spoofed, through the engine: who is named, how soon, and that sound ones stay healthy."""

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import cos, pi, radians, sin

import numpy as np
import pytest

from bench.integrity_flights import DENIED, STEP_S, Flight, Scenario, fly_step, fresh_engine
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.messages.inbound import EkfStatus, FromVehicle, GlobalPosition, GpsReceiver, PeerRange

SPOOFED_AT_S = 12.0
M_PER_DEGREE = 111_195.0
Offset = Callable[[float], tuple[float, float]]
Change = Callable[[float, FromVehicle], Iterator[FromVehicle]]


@dataclass
class Seen:
    """By vehicle when it became FAILED, and when it was first not HEALTHY, in seconds since the spoofing began."""

    engine: Engine
    failed_s: dict[int, float] = field(default_factory=dict)
    not_healthy_s: dict[int, float] = field(default_factory=dict)


def shifted(message: FromVehicle, offset_m: tuple[float, float]) -> FromVehicle:
    if not isinstance(message, GlobalPosition | GpsReceiver):
        return message
    east_m, north_m = offset_m
    lon_m = M_PER_DEGREE * cos(radians(message.lat_deg))
    return replace(message, lat_deg=message.lat_deg + north_m / M_PER_DEGREE, lon_deg=message.lon_deg + east_m / lon_m)


@lru_cache
def before_the_spoofing(scenario: Scenario, seed: int) -> bytes:
    """One draw until the spoofing begins: the same whatever happens then. Pickled: read several times faster than copied."""
    engine, flight = fresh_engine(), Flight(scenario, seed)
    for step in range(round(SPOOFED_AT_S / STEP_S) + 1):
        fly_step(engine, flight, step * STEP_S)
    return pickle.dumps((engine, flight), pickle.HIGHEST_PROTOCOL)


def fly(scenario: Scenario, seed: int, offsets: dict[int, Offset], change: Change | None = None, watched_s: float = 6.0) -> Seen:
    """Fly one draw; `offsets` gives a vehicle's spoofed offset by the time since the spoofing began."""
    engine, flight = pickle.loads(before_the_spoofing(scenario, seed))
    seen = Seen(engine)
    for step in range(round(SPOOFED_AT_S / STEP_S) + 1, round((SPOOFED_AT_S + watched_s) / STEP_S)):
        t = step * STEP_S
        since_s = t - SPOOFED_AT_S
        for message in flight.messages(t):
            if message.sysid in offsets:
                message = shifted(message, offsets[message.sysid](since_s))
            for each in change(t, message) if change is not None else (message,):
                seen.engine.receive(each)
        seen.engine.poll(t)
        for sysid in seen.engine.sysids():
            state = seen.engine.gps_state(sysid)
            if state is GpsState.FAILED:
                seen.failed_s.setdefault(sysid, since_s)
            if state is not GpsState.HEALTHY:
                seen.not_healthy_s.setdefault(sysid, since_s)
    return seen


def stepped(rng: np.random.Generator, size_m: float) -> Offset:
    angle = rng.uniform(0.0, 2.0 * pi)
    offset_m = size_m * cos(angle), size_m * sin(angle)
    return lambda _: offset_m


@pytest.mark.parametrize("size_m", [60.0, 200.0])
@pytest.mark.parametrize(("vehicles", "mutual"), [(3, True), (4, False), (4, True), (6, False), (6, True)])
def test_a_stepped_receiver_is_named_within_five_seconds_and_the_sound_ones_stay_healthy(vehicles, mutual, size_m):
    """Two draws of each, ranges from the vehicle only or among all."""
    for seed in range(2):
        scenario = Scenario(peers=vehicles - 1, mutual=mutual, lost=False)
        seen = fly(scenario, seed, {DENIED: stepped(np.random.default_rng([seed, vehicles]), size_m)})
        assert seen.failed_s.keys() == {DENIED}
        assert seen.failed_s[DENIED] <= 5.0
        assert seen.not_healthy_s.keys() == {DENIED}


def test_one_that_reports_trouble_itself_takes_no_sound_vehicle_along():
    """Its EKF reports a glitch: it is no witness, and its receiver is tested by itself."""

    def glitching(t: float, message: FromVehicle) -> Iterator[FromVehicle]:
        yield message
        if isinstance(message, GpsReceiver) and message.sysid == DENIED and t > SPOOFED_AT_S + 1.0:
            yield EkfStatus(DENIED, t, gps_glitching=True, constant_position_mode=False, horizontal_position_absolute=True)

    for seed in range(2):
        for size_m in (30.0, 200.0):
            offsets = {DENIED: stepped(np.random.default_rng(seed), size_m)}
            seen = fly(Scenario(peers=3, mutual=False, lost=False), seed, offsets, glitching)
            assert seen.not_healthy_s.keys() == {DENIED}
            assert seen.failed_s[DENIED] <= 5.0


@pytest.mark.parametrize("mutual", [True, False])
def test_one_that_reports_trouble_but_is_right_is_not_failed(mutual):
    """Suspect by its own report alone; its receiver agrees with the ranges."""

    def glitching(t: float, message: FromVehicle) -> Iterator[FromVehicle]:
        yield message
        if isinstance(message, GpsReceiver) and message.sysid == DENIED and t > SPOOFED_AT_S:
            yield EkfStatus(DENIED, t, gps_glitching=True, constant_position_mode=False, horizontal_position_absolute=True)

    for seed in range(2):
        seen = fly(Scenario(peers=4, mutual=mutual, lost=False), seed, {}, glitching)
        assert seen.not_healthy_s.keys() == {DENIED}
        assert not seen.failed_s


def test_two_of_five_that_are_spoofed_alike_are_named_together():
    for seed in range(2):
        alike = stepped(np.random.default_rng(seed), 120.0)
        seen = fly(Scenario(peers=5, mutual=True), seed, {1: alike, 2: alike})
        assert seen.failed_s.keys() - {DENIED} == {1, 2}
        assert max(seen.failed_s[1], seen.failed_s[2]) <= 5.0
        assert seen.not_healthy_s.keys() == {1, 2, DENIED}


def test_two_of_four_that_are_walked_off_alike_fail_nobody():
    """Which two are right is open: nobody is FAILED, all are suspected, nobody is an anchor."""
    for seed in range(2):
        alike = dict.fromkeys((1, 2), lambda since_s: (3.0 * since_s, 0.0))
        seen = fly(Scenario(peers=4, mutual=True), seed, alike, watched_s=12.0)
        assert seen.failed_s.keys() == {DENIED}
        assert seen.not_healthy_s.keys() == {1, 2, 3, 4, DENIED}


@pytest.mark.parametrize(("added_m", "scale"), [(12.0, 1.0), (4.0, 1.0), (0.0, 1.01), (100.0, 1.0)])
@pytest.mark.parametrize("mutual", [True, False])
def test_a_ranging_device_that_is_off_fails_nobodys_receiver(mutual, added_m, scale):
    def biased(t: float, message: FromVehicle) -> Iterator[FromVehicle]:
        if isinstance(message, PeerRange) and message.sysid == DENIED and t > SPOOFED_AT_S:
            message = replace(message, range_m=message.range_m * scale + added_m)
        yield message

    assert not fly(Scenario(peers=4, mutual=mutual, lost=False), 0, {}, biased).failed_s
