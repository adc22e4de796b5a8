"""Integrity: how soon a walked-off peer is excluded, and how often a sound one is, on seeded flights fed to the engine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, exp, pi, sin, sqrt

import numpy as np

from bench.figures import Figure
from gcs_coloc.core.bound import horizontal_bound_95_m
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.health import GpsState
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages import ClockReference, GlobalPosition, GpsReceiver, Inbound, PeerRange, TimeBase
from gcs_coloc.estimators.registry import load_estimator

STEP_S = 0.2
_ORIGIN = LocalFrame(47.0, 8.0, 400.0)
SUBJECT, LIAR, _PEERS = 5, 1, (1, 2, 3, 4)
_GPS_SIGMA_M, _GPS_TIME_S, _RANGE_SIGMA_M, _VELOCITY_SIGMA_MPS = 1.5, 60.0, 1.0, 0.2
_LOST_AT_S, SPOOFED_AT_S, _SPOOF_MPS, _GIVEN_UP_S = 5.0, 20.0, 2.0, 60.0


@dataclass(frozen=True, slots=True)
class _Course:
    """A level circle: centre, radius (m), speed (m/s), phase (rad) and height (m)."""

    centre_m: tuple[float, float]
    radius_m: float
    speed_mps: float
    phase: float
    height_m: float

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        a = self.phase + self.speed_mps / self.radius_m * t
        position = (self.centre_m[0] + self.radius_m * sin(a), self.centre_m[1] + self.radius_m * cos(a), self.height_m)
        return np.array(position), self.speed_mps * np.array((cos(a), -sin(a), 0.0))


class Flight:
    """Five vehicles on wide circles with slow GPS errors of their own; vehicle 1 is walked off from 20 s to `spoofed_until_s`."""

    def __init__(self, seed: int, *, mutual: bool, lost: bool, spoofed_until_s: float) -> None:
        self._rng = rng = np.random.default_rng(seed)
        self._mutual, self._lost, self._spoofed_until_s = mutual, lost, spoofed_until_s
        corners = {1: (-900.0, -900.0), 2: (900.0, -900.0), 3: (900.0, 900.0), 4: (-900.0, 900.0), 5: (0.0, 0.0)}
        self.courses = {
            v: _Course(
                (x + rng.uniform(-300, 300), y + rng.uniform(-300, 300)),
                rng.uniform(500, 900),
                rng.uniform(15, 25),
                rng.uniform(0, 2 * pi),
                rng.uniform(80, 160),
            )
            for v, (x, y) in corners.items()
        }
        self._error = {v: _GPS_SIGMA_M * rng.standard_normal(3) for v in corners}
        towards = rng.uniform(0, 2 * pi)
        self._away = np.array((cos(towards), sin(towards), 0.0))

    def messages(self, t: float) -> Iterator[Inbound]:
        """Yield what all vehicles say at one step."""
        keep = exp(-STEP_S / _GPS_TIME_S)
        for v, course in self.courses.items():
            self._error[v] = keep * self._error[v] + _GPS_SIGMA_M * sqrt(1.0 - keep * keep) * self._rng.standard_normal(3)
            position, velocity = course.at(t)
            velocity = velocity + _VELOCITY_SIGMA_MPS * self._rng.standard_normal(3)
            claimed = position + self._error[v]
            if v == LIAR and SPOOFED_AT_S < t < self._spoofed_until_s:
                claimed = claimed + (t - SPOOFED_AT_S) * _SPOOF_MPS * self._away
                velocity = velocity + _SPOOF_MPS * self._away
            lat, lon, alt = _ORIGIN.geodetic_from_enu(*(float(x) for x in claimed))
            ve, vn, vu = (float(x) for x in velocity)
            lost = self._lost and v == SUBJECT and t > _LOST_AT_S
            yield GpsReceiver(v, t, 0, 1 if lost else 3, lat, lon, alt, 12, 0.9, _GPS_SIGMA_M, _GPS_SIGMA_M, _VELOCITY_SIGMA_MPS)
            yield GlobalPosition(v, t, t, lat, lon, alt, vn, ve, -vu)
        for i in self.courses:
            for j in self.courses:
                if i != j and (i == SUBJECT or (self._mutual and j != SUBJECT)):
                    true_m = float(np.linalg.norm(self.courses[i].at(t)[0] - self.courses[j].at(t)[0]))
                    range_m = true_m + _RANGE_SIGMA_M * float(self._rng.standard_normal())
                    yield PeerRange(i, t, j, range_m, _RANGE_SIGMA_M, t, TimeBase.BOOT, None, None, 0)


def measure(quick: bool) -> list[Figure]:
    """Exclusion of a ramp-spoofed peer, and false exclusion in clean flight."""
    runs, hours = (6, 0.05) if quick else (200, 3.0)
    return [_exclusion(mutual, runs) for mutual in (True, False)] + [_false_exclusion(hours)]


def fresh_engine() -> Engine:
    """Return an engine with the fleet filter and default settings."""
    engine = Engine(load_estimator("fleet", {}), EngineSettings(request_streams=False))
    engine.receive(ClockReference(0.0, None))
    return engine


def fly_step(engine: Engine, flight: Flight, t: float) -> None:
    """Feed one step of a flight to an engine and let it act."""
    for message in flight.messages(t):
        engine.receive(message)
    engine.poll(t)


def error_and_bound_m(engine: Engine, flight: Flight, t: float) -> tuple[float, float] | None:
    """Return the subject's horizontal error and its 95 % bound, or None where it is not located."""
    where, frame = engine.where(SUBJECT, t), engine.feed.frame
    if not isinstance(where, Estimate) or frame is None:
        return None
    true_m = flight.courses[SUBJECT].at(t)[0]
    at_m = frame.enu_from_geodetic(*_ORIGIN.geodetic_from_enu(*(float(x) for x in true_m)))
    return float(np.hypot(*(where.position_enu_m - np.array(at_m))[:2])), horizontal_bound_95_m(where.covariance)


def _exclusion(mutual: bool, runs: int) -> Figure:
    kept, after_s = 0, []
    for seed in range(runs):
        excluded_s, passed_s = _spoofed_run(seed, mutual)
        kept += excluded_s < passed_s
        after_s.append(excluded_s - SPOOFED_AT_S)
    return Figure(
        "integrity",
        f"peer spoofed at {_SPOOF_MPS:g} m/s, {'mutual' if mutual else 'only the subject' + chr(39) + 's'} ranges, {runs} runs",
        f"excluded in time in {kept / runs:.0%}, median after {np.median(after_s):.1f} s",
        ">= 95 % before the subject's error passes 1.5 x its 95 % bound",
        kept >= 0.95 * runs,
    )


def _spoofed_run(seed: int, mutual: bool) -> tuple[float, float]:
    """When the liar was trusted no more, and when the subject's error first passed 1.5 times its bound (s, inf for never)."""
    engine, flight = fresh_engine(), Flight(seed, mutual=mutual, lost=True, spoofed_until_s=_GIVEN_UP_S)
    passed_s = float("inf")
    for step in range(round(_GIVEN_UP_S / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t <= SPOOFED_AT_S:
            continue
        liar, found = engine.fleet.get(LIAR), error_and_bound_m(engine, flight, t)
        if found is not None and found[0] > 1.5 * found[1]:
            passed_s = min(passed_s, t)
        if liar is not None and liar.health.state is not GpsState.HEALTHY:
            return t, passed_s
    return float("inf"), passed_s


def _false_exclusion(hours: float) -> Figure:
    """Clean flight of five vehicles with mutual ranges; each time that one is no longer trusted counts."""
    excluded, flights = 0, 12
    for seed in range(flights):
        engine, flight = fresh_engine(), Flight(1000 + seed, mutual=True, lost=False, spoofed_until_s=0.0)
        distrusted: frozenset[int] = frozenset()
        for step in range(round(hours / flights * 3600.0 / STEP_S)):
            fly_step(engine, flight, step * STEP_S)
            now = frozenset(v.sysid for v in engine.fleet if v.health.state not in (GpsState.HEALTHY, GpsState.UNKNOWN))
            excluded += len(now - distrusted)
            distrusted = now
    vehicle_hours = hours * (len(_PEERS) + 1)
    return Figure(
        "integrity",
        f"false exclusions in {vehicle_hours:g} vehicle-hours of clean flight",
        str(excluded),
        "< 1 in 10 vehicle-hours",
        excluded < max(0.1 * vehicle_hours, 1.0) if vehicle_hours >= 10.0 or excluded else None,
    )
