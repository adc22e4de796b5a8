"""Flights with one denied vehicle among peers that may be faulty, as the engine hears them: seeded, of any size and noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, exp, hypot, inf, pi, sin, sqrt
from typing import Protocol

import numpy as np

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, FloatArray
from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.messages.inbound import FromVehicle, GlobalPosition, GpsReceiver, PeerRange, TimeBase
from gcs_coloc.estimators.registry import load_estimator

STEP_S = 0.2
DENIED, FAULTY = 100, 1
LOST_AT_S, SPOOFED_AT_S = 5.0, 20.0
ORIGIN = LocalFrame(47.0, 8.0, 400.0)
"""The frame of the courses."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What flies and what is measured.

    `peers` vehicles around a vehicle (`lost`: its GPS fails after 5 s), each on a level circle with a radius and a speed drawn
    from `radius_m` and `speed_mps`, spread over a square of +-`extent_m`. GPS errors are of `gps_sigma_m` per axis, slow over
    `gps_time_s`, `gps_white_share` of their variance white; ranges of the vehicle, with `mutual` of all, are of `range_sigma_m`,
    `late_share` of them 5 to `late_m` too long. Peer 1 is walked off at `walk_mps` from 20 s on, after a step of `jump_m`.
    From `returns_at_s` on the vehicle's receiver has a fix again: `return_jump_m` off, and walked off at `return_walk_mps`.
    """

    peers: int = 4
    mutual: bool = True
    lost: bool = True
    gps_sigma_m: float = 1.5
    gps_time_s: float = 60.0
    gps_white_share: float = 0.0
    range_sigma_m: float = 1.0
    late_share: float = 0.0
    late_m: float = 100.0
    radius_m: tuple[float, float] = (500.0, 900.0)
    speed_mps: tuple[float, float] = (15.0, 25.0)
    extent_m: float = 900.0
    walk_mps: float = 0.0
    jump_m: float = 0.0
    returns_at_s: float = inf
    return_jump_m: float = 0.0
    return_walk_mps: float = 0.0


class Course(Protocol):
    """Where a vehicle flies."""

    def at(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Return place (m) and velocity (m/s), (3,) each, ENU."""
        ...


@dataclass(frozen=True, slots=True)
class _Circle:
    """A level circle: centre, radius (m), speed (m/s), phase (rad) and height (m)."""

    centre_m: tuple[float, float]
    radius_m: float
    speed_mps: float
    phase: float
    height_m: float

    def at(self, t: float) -> tuple[FloatArray, FloatArray]:
        a = self.phase + self.speed_mps / self.radius_m * t
        position = (self.centre_m[0] + self.radius_m * sin(a), self.centre_m[1] + self.radius_m * cos(a), self.height_m)
        return np.array(position), self.speed_mps * np.array((cos(a), -sin(a), 0.0))


class Flight:
    """One draw of a scenario; vehicle 1 is spoofed until `fault_free_from_s`, displaced along `away` (a unit vector)."""

    def __init__(self, scenario: Scenario, seed: int, fault_free_from_s: float = inf) -> None:
        self.scenario = s = scenario
        self._rng = rng = np.random.default_rng(seed)
        self._fault_free_from_s = fault_free_from_s
        # Corners of a regular polygon, shifted by a third of its size at random.
        turn, shift_m = rng.uniform(0, 2 * pi), s.extent_m / 3.0
        centres = {
            v: s.extent_m * sqrt(2.0) * np.array((cos(a), sin(a)))
            for v in range(1, s.peers + 1)
            for a in [turn + 2 * pi * v / s.peers]
        }
        centres[DENIED] = np.zeros(2)
        self.courses: dict[int, Course] = {
            v: _Circle(
                (x + rng.uniform(-shift_m, shift_m), y + rng.uniform(-shift_m, shift_m)),
                rng.uniform(*s.radius_m),
                rng.uniform(*s.speed_mps) * rng.choice((-1.0, 1.0)),
                rng.uniform(0, 2 * pi),
                rng.uniform(80, 160),
            )
            for v, (x, y) in centres.items()
        }
        self._slow_m = s.gps_sigma_m * sqrt(1.0 - s.gps_white_share)
        self._error = {v: self._slow_m * rng.standard_normal(3) for v in self.courses}
        towards = rng.uniform(0, 2 * pi)
        self.away = np.array((cos(towards), sin(towards), 0.0))

    def messages(self, t: float) -> Iterator[FromVehicle]:
        """Yield what all vehicles say at one step."""
        s, rng = self.scenario, self._rng
        keep, white_m = exp(-STEP_S / s.gps_time_s), s.gps_sigma_m * sqrt(s.gps_white_share)
        for v, course in self.courses.items():
            self._error[v] = keep * self._error[v] + self._slow_m * sqrt(1.0 - keep * keep) * rng.standard_normal(3)
            position, velocity = course.at(t)
            velocity = velocity + 0.2 * rng.standard_normal(3)
            reported = position + self._error[v] + white_m * rng.standard_normal(3)
            if v == FAULTY and SPOOFED_AT_S < t < self._fault_free_from_s:
                reported = reported + ((t - SPOOFED_AT_S) * s.walk_mps + s.jump_m) * self.away
                velocity = velocity + s.walk_mps * self.away
            if v == DENIED and t > s.returns_at_s:
                reported = reported + ((t - s.returns_at_s) * s.return_walk_mps + s.return_jump_m) * self.away
                velocity = velocity + s.return_walk_mps * self.away
            lat, lon, alt = ORIGIN.geodetic_from_enu(*(float(x) for x in reported))
            ve, vn, vu = (float(x) for x in velocity)
            lost = s.lost and v == DENIED and LOST_AT_S < t <= s.returns_at_s
            yield GpsReceiver(v, t, 0, 1 if lost else 3, lat, lon, alt, 12, 0.9, s.gps_sigma_m, s.gps_sigma_m, 0.2, t)
            yield GlobalPosition(v, t, t, lat, lon, alt, vn, ve, -vu)
        for i in self.courses:
            for j in self.courses:
                if i != j and (i == DENIED or (s.mutual and j != DENIED)):
                    range_m = float(np.linalg.norm(self.courses[i].at(t)[0] - self.courses[j].at(t)[0]))
                    range_m += s.range_sigma_m * float(rng.standard_normal())
                    if s.late_share and rng.random() < s.late_share:
                        range_m += rng.uniform(5.0, s.late_m)
                    yield PeerRange(i, t, j, max(range_m, 0.0), s.range_sigma_m, t, TimeBase.BOOT, None, None, 0)


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


def enu_m(message: GlobalPosition) -> FloatArray:
    """Return the position that a message reports, in the flights' own frame (3,), m."""
    return np.array(ORIGIN.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m))


def error_and_bound_m(engine: Engine, flight: Flight, t: float) -> tuple[float, float] | None:
    """Return the denied vehicle's horizontal error and its 95 % bound; None where it would be sent no fix."""
    where, frame = engine.estimate(DENIED, t), engine.frame
    if not isinstance(where, Estimate) or frame is None:
        return None
    bound_m = horizontal_bound_95_m(where.covariance)
    if bound_m > AidingSettings().alert_limit_m:
        return None
    true_m = flight.courses[DENIED].at(t)[0]
    east_m, north_m, _ = frame.enu_from_geodetic(*ORIGIN.geodetic_from_enu(*(float(x) for x in true_m)))
    return hypot(where.position_enu_m[0] - east_m, where.position_enu_m[1] - north_m), bound_m
