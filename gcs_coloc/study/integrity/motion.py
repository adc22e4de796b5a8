"""True motion of the trials' vehicles: planes that bank, and copters that fly or hover."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from math import atan2, cos, hypot, pi, radians, remainder, sin, sqrt, tan

import numpy as np

from gcs_coloc.core.measurements import FloatArray, Vector3
from gcs_coloc.study.integrity.flight_classes import FlightClass, Layout, Motion

STEP_S = 0.05
"""Step of the true motion; measurements lie between two steps. Chosen: 0.5 m at 10 m/s, straight within a millimetre."""
GRAVITY_MPS2 = 9.80665  # source: standard gravity, ISO 80000-3
_PLANE_SPEED_MPS = (14.0, 28.0)  # chosen: small fixed-wing aircraft
_COPTER_SPEED_MPS = (4.0, 14.0)  # chosen: multirotors on missions
_HEIGHT_M = (60.0, 200.0)  # chosen: where small aircraft fly
_ROLL_RATE_RADPS = (radians(30.0), radians(70.0))
"""How fast a plane rolls, and how steep it turns, are drawn for each. Source: small unmanned planes, ArduPlane's defaults."""
_TURN_BACK_BANK = radians(30.0)
_STRAIGHT_SHARE = 0.4  # chosen: missions are legs and turns
_LEAST_HELD_S, _MEAN_HELD_S = 2.0, 12.0  # chosen: some leg is long, few are short
_DRAG_PER_S = (0.1, 0.5)
"""How fast drag takes a copter along with the air, drawn for each. Source: 0.4 to 0.5 of a light quadrotor (Faessler, Franchi,
Scaramuzza 2018); ArduCopter's simulated one has 0.5. Chosen: heavy ones have less."""
_TRIM_SIGMA = radians(1.0)
"""Lasting error of each axis of a copter's tilt. Chosen: an autopilot levelled by hand is 2 degrees off at times."""
_GUST_TIME_S = 4.0
"""Gusts are a Gauss-Markov process of this time. Chosen: shorter than the 5 to 10 s of Dryden's model at 100 m and 20 m/s."""


class Trajectory:
    """True motion of one vehicle at steps of `STEP_S`.

    Positions (N, 3) in m and velocities (N, 3) in m/s are east, north, up. Attitude (N, 3) in rad is roll, pitch and yaw from
    north, clockwise. `airspeed_mps` (N,) is None for a vehicle without wings.
    """

    def __init__(
        self, positions_m: FloatArray, velocities_mps: FloatArray, attitude_rad: FloatArray, airspeed_mps: FloatArray | None
    ) -> None:
        self.positions_m, self.velocities_mps = positions_m, velocities_mps
        self.attitude_rad, self.airspeed_mps = attitude_rad, airspeed_mps
        # As floats: what is asked for is one step at a time, for which numpy takes several times as long.
        self._positions_m, self._velocities_mps = positions_m.tolist(), velocities_mps.tolist()
        self._attitude_rad = attitude_rad.tolist()
        self._airspeed_mps: list[float] | None = None if airspeed_mps is None else airspeed_mps.tolist()

    def position(self, at_s: float) -> Vector3:
        """Return the position at a time, m."""
        return self._between(self._positions_m, at_s)

    def velocity(self, at_s: float) -> Vector3:
        """Return the velocity at a time, m/s."""
        return self._between(self._velocities_mps, at_s)

    def attitude(self, at_s: float) -> Vector3:
        """Return roll, pitch and yaw at the step before a time, rad."""
        roll, pitch, yaw = self._attitude_rad[int(self._place(at_s))]
        return roll, pitch, yaw

    def airspeed(self, at_s: float) -> float | None:
        """Return the airspeed at the step before a time, m/s."""
        return None if self._airspeed_mps is None else self._airspeed_mps[int(self._place(at_s))]

    def _place(self, at_s: float) -> float:
        return min(max(at_s / STEP_S, 0.0), len(self._positions_m) - 1.001)

    def _between(self, rows: list[Sequence[float]], at_s: float) -> Vector3:
        place = self._place(at_s)
        return between_rows(rows, int(place), place - int(place))


def between_rows(rows: Sequence[Sequence[float]], step: int, share: float) -> Vector3:
    """Return the vector a share of the way from one row to the next."""
    (e, n, u), (next_e, next_n, next_u) = rows[step], rows[step + 1]
    return e + share * (next_e - e), n + share * (next_n - n), u + share * (next_u - u)


def gauss_markov(rng: np.random.Generator, count: int, step_s: float, sigma: float, time_s: float, axes: int = 3) -> FloatArray:
    """Return a stationary Gauss-Markov process, shape (count, axes).

    `sigma` is its standard deviation, in the unit of the result. `time_s` is its correlation time.
    """
    keep = float(np.exp(-step_s / time_s))
    noise = sigma * np.sqrt(1.0 - keep * keep) * rng.standard_normal((count, axes))
    noise[0] = sigma * rng.standard_normal(axes)
    columns = [list(accumulate(column, lambda before, white: keep * before + white)) for column in noise.T.tolist()]
    return np.array(columns).T


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
            found.append(_copter(rng, drawn, steps, centre, radius_m, wind_mps, is_agile=motion is Motion.AGILE))
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
    """Fly a plane in level turns of random bank and length, with slow climbs.

    Beyond `radius_m` from the centre, or two radii of its turn if that is more, it turns back.
    """
    speed, steepest = rng.uniform(*_PLANE_SPEED_MPS), radians(rng.uniform(*drawn.bank_deg))
    roll_rate = rng.uniform(*_ROLL_RATE_RADPS)
    turn_radius_m = speed**2 / (GRAVITY_MPS2 * tan(_TURN_BACK_BANK))
    gusts = gauss_markov(rng, steps, STEP_S, rng.uniform(*drawn.gust_mps), _GUST_TIME_S) * (1.0, 1.0, 0.3)
    (centre_e, centre_n), (wind_e, wind_n, _) = centre_m.tolist(), wind_mps.tolist()
    east, north = (centre_m + rng.uniform(-0.5, 0.5, 2) * radius_m).tolist()
    up = rng.uniform(*_HEIGHT_M)
    heading, bank, wanted, climb, wanted_climb, until_s = rng.uniform(0.0, 2.0 * pi), 0.0, 0.0, 0.0, 0.0, 0.0
    positions, velocities, attitude, through_air = [], [], [], []
    for k, (gust_e, gust_n, gust_u) in enumerate(gusts.tolist()):
        if k * STEP_S >= until_s:
            until_s = k * STEP_S + _LEAST_HELD_S + rng.exponential(_MEAN_HELD_S - _LEAST_HELD_S)
            wanted = 0.0 if rng.random() < _STRAIGHT_SHARE else rng.uniform(-steepest, steepest)
            wanted_climb = rng.uniform(-2.0, 2.0) if up > _HEIGHT_M[0] else 2.0
        target = wanted
        if hypot(east - centre_e, north - centre_n) > max(radius_m, 2.0 * turn_radius_m):
            off = remainder(atan2(centre_e - east, centre_n - north) - heading, 2.0 * pi)
            target = min(max(1.5 * off, -_TURN_BACK_BANK), _TURN_BACK_BANK)
        bank += min(max(target - bank, -roll_rate * STEP_S), roll_rate * STEP_S)
        climb += 0.5 * STEP_S * (wanted_climb - climb)
        air_e, air_n = speed * sin(heading), speed * cos(heading)
        ve, vn, vu = air_e + wind_e + gust_e, air_n + wind_n + gust_n, climb + gust_u
        positions.append((east, north, up))
        velocities.append((ve, vn, vu))
        through_air.append((air_e, air_n))
        attitude.append((bank, climb / speed, remainder(heading, 2.0 * pi)))
        heading += GRAVITY_MPS2 * tan(bank) / speed * STEP_S
        east, north, up = east + ve * STEP_S, north + vn * STEP_S, up + vu * STEP_S
    # A gust is felt at once: what the sensor measures is the motion against the air around it.
    along = (gusts[:, np.newaxis, :2] @ np.array(through_air)[:, :, np.newaxis])[:, 0, 0]
    return Trajectory(np.array(positions), np.array(velocities), np.array(attitude), speed - along / speed)


def _copter(
    rng: np.random.Generator,
    drawn: FlightClass,
    steps: int,
    centre_m: FloatArray,
    radius_m: float,
    wind_mps: FloatArray,
    *,
    is_agile: bool,
) -> Trajectory:
    """Fly a copter to random waypoints within `radius_m` of the centre.

    An agile copter gets a new waypoint every 2 to 6 s, any other every 8 to 30 s.
    """
    fastest, most = rng.uniform(*_COPTER_SPEED_MPS), rng.uniform(*drawn.acceleration_mps2)
    if is_agile:
        fastest = max(fastest, 10.0)
    yaw, until_s = rng.uniform(-pi, pi), 0.0
    place = np.array((*(centre_m + rng.uniform(-0.5, 0.5, 2) * radius_m), rng.uniform(20.0, 120.0)))
    velocity, acceleration, target = np.zeros(3), np.zeros(3), place.copy()
    positions, velocities, accelerations = np.empty((steps, 3)), np.empty((steps, 3)), np.empty((steps, 3))
    for k in range(steps):
        if k * STEP_S >= until_s:
            until_s = k * STEP_S + (rng.uniform(2.0, 6.0) if is_agile else rng.uniform(8.0, 30.0))
            target = np.array((*(centre_m + rng.uniform(-1.0, 1.0, 2) * radius_m), rng.uniform(20.0, 120.0)))
        wanted = target - place
        length = sqrt(wanted.dot(wanted))
        # As fast as it can still stop at the waypoint.
        wanted *= min(fastest, sqrt(most * length)) / max(length, 1e-6)
        push = (wanted - velocity) / 0.4
        push *= min(1.0, most / max(sqrt(push.dot(push)), 1e-6))
        # The body has to tilt first: a first-order lag of a quarter of a second.
        acceleration += (push - acceleration) * STEP_S / 0.25
        velocity = velocity + acceleration * STEP_S
        place = place + velocity * STEP_S
        positions[k], velocities[k], accelerations[k] = place, velocity, acceleration
    # Drawn apart: what else a flight draws is what it was before copters had drag.
    air = rng.spawn(1)[0]
    through_air_mps = velocities - wind_mps
    through_air_mps[:, :2] -= gauss_markov(air, steps, STEP_S, air.uniform(*drawn.gust_mps), _GUST_TIME_S, 2)
    attitude = _tilt(accelerations + air.uniform(*_DRAG_PER_S) * through_air_mps, yaw)
    attitude[:, :2] += air.normal(0.0, _TRIM_SIGMA, 2)
    return Trajectory(positions, velocities, attitude, None)


def _tilt(forces_mps2: FloatArray, yaw: float) -> FloatArray:
    """Return the attitude (N, 3) whose thrust is gravity and these forces (N, 3) m/s^2, east, north, up."""
    east, north, up = forces_mps2.T
    up = up + GRAVITY_MPS2
    forward, right = east * sin(yaw) + north * cos(yaw), east * cos(yaw) - north * sin(yaw)
    return np.stack([np.arctan2(right, np.hypot(forward, up)), -np.arctan2(forward, up), np.full(len(up), yaw)], axis=1)


def _follow(rng: np.random.Generator, leader: Trajectory, offset_m: FloatArray, steps: int) -> Trajectory:
    """Fly the leader's course beside it, swaying by some metres: the airspeed and bank are the leader's."""
    sway = gauss_markov(rng, steps, STEP_S, 3.0, 20.0)
    # Smoothed, so that the velocity of the swaying is a real one.
    kernel = np.ones(100) / 100.0
    sway = np.stack([np.convolve(sway[:, axis], kernel, mode="same") for axis in range(3)], axis=1)
    positions = leader.positions_m + sway + (*offset_m, rng.uniform(-10.0, 10.0))
    velocities = leader.velocities_mps + np.gradient(sway, STEP_S, axis=0)
    return Trajectory(positions, velocities, leader.attitude_rad, leader.airspeed_mps)
