"""True motion of the trials' vehicles: planes that bank, copters between waypoints, agile ones, hovering ones."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, radians, remainder, sin, tan

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.study.integrity.flight_classes import FlightClass, Layout, Motion

STEP_S = 0.05
"""Step of the true motion; measurements lie between two steps. Chosen: 0.5 m at 10 m/s, straight within a millimetre."""
_GRAVITY_MPS2 = 9.80665  # source: standard gravity, ISO 80000-3
_PLANE_SPEED_MPS = (14.0, 28.0)  # chosen: small fixed-wing aircraft
_COPTER_SPEED_MPS = (4.0, 14.0)  # chosen: multirotors on missions
_HEIGHT_M = (60.0, 200.0)  # chosen: where small aircraft fly
_ROLL_RATE_RADPS = (radians(30.0), radians(70.0))
"""How fast a plane rolls, and how steep it turns, are drawn for each. Source: small unmanned planes, ArduPlane's defaults."""
_TURN_BACK_BANK = radians(30.0)
_STRAIGHT_SHARE = 0.4  # chosen: missions are legs and turns
_LEAST_HELD_S, _MEAN_HELD_S = 2.0, 12.0  # chosen: some leg is long, few are short
_GUST_TIME_S = 4.0
"""Gusts are a Gauss-Markov process of this time. Source: Dryden's model at 100 m and 20 m/s gives 5 to 10 s."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """True motion at steps of `STEP_S`: positions (N, 3) m and velocities (N, 3) m/s ENU, attitude (N, 3) rad, airspeed (N,).

    Attitude is roll, pitch and yaw from north, clockwise. `airspeed_mps` is None of a vehicle without wings.
    """

    positions_m: FloatArray
    velocities_mps: FloatArray
    attitude_rad: FloatArray
    airspeed_mps: FloatArray | None

    def position(self, at_s: float) -> FloatArray:
        """Return the position (3,) at a time, m."""
        return self._between(self.positions_m, at_s)

    def velocity(self, at_s: float) -> FloatArray:
        """Return the velocity (3,) at a time, m/s."""
        return self._between(self.velocities_mps, at_s)

    def attitude(self, at_s: float) -> FloatArray:
        """Return roll, pitch and yaw (3,) at the step before a time, rad."""
        return np.asarray(self.attitude_rad[self._step(at_s)[0]])

    def airspeed(self, at_s: float) -> float | None:
        """Return the airspeed at the step before a time, m/s."""
        return None if self.airspeed_mps is None else float(self.airspeed_mps[self._step(at_s)[0]])

    def _step(self, at_s: float) -> tuple[int, float]:
        place = min(max(at_s / STEP_S, 0.0), len(self.positions_m) - 1.001)
        return int(place), place - int(place)

    def _between(self, rows: FloatArray, at_s: float) -> FloatArray:
        step, share = self._step(at_s)
        return np.asarray(rows[step] + share * (rows[step + 1] - rows[step]))


def gauss_markov(rng: np.random.Generator, count: int, step_s: float, sigma: float, time_s: float, axes: int = 3) -> FloatArray:
    """Return a stationary Gauss-Markov process (count, axes) of a standard deviation and a correlation time."""
    keep = float(np.exp(-step_s / time_s))
    noise = sigma * np.sqrt(1.0 - keep * keep) * rng.standard_normal((count, axes))
    values = np.empty((count, axes))
    values[0] = sigma * rng.standard_normal(axes)
    for k in range(1, count):
        values[k] = keep * values[k - 1] + noise[k]
    return values


def draw_trajectories(rng: np.random.Generator, drawn: FlightClass, duration_s: float, vehicles: int) -> list[Trajectory]:
    """Draw the motion of all vehicles of a flight, the denied ones first."""
    steps = round(duration_s / STEP_S) + 2
    direction, speed = rng.uniform(0.0, 2.0 * pi), rng.uniform(*drawn.wind_mps)
    wind_mps = np.array((speed * sin(direction), speed * cos(direction), 0.0))
    extent_m = rng.uniform(*drawn.extent_m)
    centres_m = _centres(rng, drawn, vehicles, extent_m)
    if drawn.layout is Layout.CONVOY:
        leader = _plane(rng, drawn, steps, np.zeros(2), 5.0 * extent_m, wind_mps)
        return [_follow(rng, leader, centre, steps) for centre in centres_m]
    found = []
    for vehicle, centre in enumerate(centres_m):
        motion = drawn.motions[int(rng.integers(len(drawn.motions)))]
        if vehicle < drawn.denied:
            motion = drawn.motions[0]
        if motion is Motion.PLANE:
            found.append(_plane(rng, drawn, steps, centre, 0.6 * extent_m, wind_mps))
        else:
            radius_m = 2.0 if motion is Motion.HOVER else 0.6 * extent_m
            found.append(_copter(rng, drawn, steps, centre, radius_m, is_agile=motion is Motion.AGILE))
    return found


def _centres(rng: np.random.Generator, drawn: FlightClass, vehicles: int, extent_m: float) -> list[FloatArray]:
    """Draw the centres (2,) m of the vehicles' areas; those of denied vehicles are near the origin."""
    denied = [rng.uniform(-0.2, 0.2, 2) * extent_m for _ in range(drawn.denied)]
    peers, turn = vehicles - drawn.denied, rng.uniform(0.0, 2.0 * pi)
    axis = np.array((sin(turn), cos(turn)))
    if drawn.layout is Layout.AROUND:
        angles = [turn + 2.0 * pi * k / peers for k in range(peers)]
        return denied + [extent_m * np.array((sin(a), cos(a))) + rng.uniform(-0.3, 0.3, 2) * extent_m for a in angles]
    if drawn.layout is Layout.ASIDE:
        return denied + [extent_m * axis + rng.uniform(-0.15, 0.15, 2) * extent_m for _ in range(peers)]
    places = np.linspace(-1.0, 1.0, vehicles if drawn.layout is Layout.CONVOY else peers)
    in_line = [extent_m * place * axis + rng.uniform(-2.0, 2.0, 2) for place in places]
    if drawn.layout is Layout.CONVOY:
        return [in_line.pop(int(rng.integers(len(in_line)))) for _ in range(vehicles)]
    return denied + in_line


def _plane(
    rng: np.random.Generator, drawn: FlightClass, steps: int, centre_m: FloatArray, radius_m: float, wind_mps: FloatArray
) -> Trajectory:
    """Fly level turns of random bank and length with slow climbs; beyond `radius_m` from the centre the plane turns back."""
    speed, steepest = rng.uniform(*_PLANE_SPEED_MPS), radians(rng.uniform(*drawn.bank_deg))
    roll_rate = rng.uniform(*_ROLL_RATE_RADPS)
    turn_radius_m = speed**2 / (_GRAVITY_MPS2 * tan(_TURN_BACK_BANK))
    gusts = gauss_markov(rng, steps, STEP_S, rng.uniform(*drawn.gust_mps), _GUST_TIME_S) * (1.0, 1.0, 0.3)
    place = np.array((*(centre_m + rng.uniform(-0.5, 0.5, 2) * radius_m), rng.uniform(*_HEIGHT_M)))
    heading, bank, wanted, climb, wanted_climb, until_s = rng.uniform(0.0, 2.0 * pi), 0.0, 0.0, 0.0, 0.0, 0.0
    positions, velocities, attitude, airspeed = np.empty((steps, 3)), np.empty((steps, 3)), np.empty((steps, 3)), np.empty(steps)
    for k in range(steps):
        if k * STEP_S >= until_s:
            until_s = k * STEP_S + _LEAST_HELD_S + rng.exponential(_MEAN_HELD_S - _LEAST_HELD_S)
            wanted = 0.0 if rng.random() < _STRAIGHT_SHARE else rng.uniform(-steepest, steepest)
            wanted_climb = rng.uniform(-2.0, 2.0) if place[2] > _HEIGHT_M[0] else 2.0
        away_m = hypot(place[0] - centre_m[0], place[1] - centre_m[1])
        target = wanted
        if away_m > max(radius_m, 2.0 * turn_radius_m):
            off = remainder(atan2(centre_m[0] - place[0], centre_m[1] - place[1]) - heading, 2.0 * pi)
            target = float(np.clip(1.5 * off, -_TURN_BACK_BANK, _TURN_BACK_BANK))
        bank += float(np.clip(target - bank, -roll_rate * STEP_S, roll_rate * STEP_S))
        climb += 0.5 * STEP_S * (wanted_climb - climb)
        air = np.array((speed * sin(heading), speed * cos(heading), climb))
        velocity = air + wind_mps + gusts[k]
        positions[k], velocities[k] = place, velocity
        attitude[k] = bank, climb / speed, remainder(heading, 2.0 * pi)
        # A gust is felt at once: what the sensor measures is the motion against the air around it.
        airspeed[k] = speed - float(gusts[k, :2] @ air[:2]) / speed
        heading += _GRAVITY_MPS2 * tan(bank) / speed * STEP_S
        place = place + velocity * STEP_S
    return Trajectory(positions, velocities, attitude, airspeed)


def _copter(
    rng: np.random.Generator, drawn: FlightClass, steps: int, centre_m: FloatArray, radius_m: float, *, is_agile: bool
) -> Trajectory:
    """Fly to random waypoints within `radius_m`; an agile copter changes them every few seconds and accelerates fully."""
    fastest, most = rng.uniform(*_COPTER_SPEED_MPS), rng.uniform(*drawn.acceleration_mps2)
    if is_agile:
        fastest = max(fastest, 10.0)
    yaw, until_s = rng.uniform(-pi, pi), 0.0
    place = np.array((*(centre_m + rng.uniform(-0.5, 0.5, 2) * radius_m), rng.uniform(20.0, 120.0)))
    velocity, acceleration, target = np.zeros(3), np.zeros(3), place.copy()
    positions, velocities, attitude = np.empty((steps, 3)), np.empty((steps, 3)), np.empty((steps, 3))
    for k in range(steps):
        if k * STEP_S >= until_s:
            until_s = k * STEP_S + (rng.uniform(2.0, 6.0) if is_agile else rng.uniform(8.0, 30.0))
            target = np.array((*(centre_m + rng.uniform(-1.0, 1.0, 2) * radius_m), rng.uniform(20.0, 120.0)))
        wanted = target - place
        length = float(np.linalg.norm(wanted))
        # As fast as it can still stop at the waypoint.
        wanted *= min(fastest, float(np.sqrt(most * length))) / max(length, 1e-6)
        push = (wanted - velocity) / 0.4
        push *= min(1.0, most / max(float(np.linalg.norm(push)), 1e-6))
        # The body has to tilt first: a first-order lag of a quarter of a second.
        acceleration += (push - acceleration) * STEP_S / 0.25
        velocity = velocity + acceleration * STEP_S
        place = place + velocity * STEP_S
        forward = acceleration[0] * sin(yaw) + acceleration[1] * cos(yaw)
        right = acceleration[0] * cos(yaw) - acceleration[1] * sin(yaw)
        positions[k], velocities[k] = place, velocity
        attitude[k] = atan2(right, _GRAVITY_MPS2), -atan2(forward, _GRAVITY_MPS2), yaw
    return Trajectory(positions, velocities, attitude, None)


def _follow(rng: np.random.Generator, leader: Trajectory, offset_m: FloatArray, steps: int) -> Trajectory:
    """Fly the leader's course beside it, swaying by some metres: the airspeed and bank are the leader's."""
    sway = gauss_markov(rng, steps, STEP_S, 3.0, 20.0)
    # Smoothed, so that the velocity of the swaying is a real one.
    kernel = np.ones(100) / 100.0
    sway = np.stack([np.convolve(sway[:, axis], kernel, mode="same") for axis in range(3)], axis=1)
    positions = leader.positions_m + sway + (*offset_m, rng.uniform(-10.0, 10.0))
    velocities = leader.velocities_mps + np.gradient(sway, STEP_S, axis=0)
    return Trajectory(positions, velocities, leader.attitude_rad, leader.airspeed_mps)
