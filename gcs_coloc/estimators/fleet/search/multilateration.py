"""Multilateration: position and velocity from ranges alone, eq. (26).

It is a robust least squares fit from many starting points. The vehicle may turn meanwhile: its accelerations are solved for as
well, each about zero with what its class can do. What its air data show of its turns is known. Few or badly placed peers allow a
reflected solution. Where altitude and motion do not decide, the position is ambiguous; only a reflection straight above or below
is returned, as one position with an open height.
A faulty device is left out (`faulty_device`).
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    FloatArray,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
)
from gcs_coloc.estimators.fleet.search.faulty_device import fit_without_faulty
from gcs_coloc.estimators.fleet.search.range_fit import LEAST_RANGES, RangesToFit

LEAST_PEERS = 2  # with one peer the position is anywhere on a sphere
_CLEARLY_WORSE = 15.0  # chosen: difference of the costs (chi-square) from which on another minimum is excluded
_DISTINCT_NIS = 25.0  # chosen: minima five sigmas apart horizontally are different positions
_VELOCITY_PRIOR_MPS = (30.0, 30.0, 5.0)  # chosen: 1-sigma of a small aircraft, east, north, up
_STRAIGHT = 0.25
"""Chosen: a height one sigma off bends a range by so many of its sigmas. With 1.0 one of twelve starts (test_reflected_start.py)
counted as known that the filter took to the wrong side."""
_HEIGHT_PRIOR_M = 300.0  # chosen: priors as wide as small aircraft fly, about rest and the mean height of the peers
_STRETCH_S = 1.0  # chosen: the acceleration is constant so long; a roll from one turn into another takes about a second


_Antennas = tuple[int, int]
"""A peer and the device that ranges it."""


class FlownThroughAir(NamedTuple):
    """How a vehicle flew through the air, by its headings and airspeeds.

    `times_s` (n,) count from the time of the problem, `velocities_mps` (n, 2) are east and north. `error_sigma_mps2`: that of an
    acceleration which they do not show; `drift_sigma_mps`: that of the wind and of a wrong heading.
    """

    times_s: FloatArray
    velocities_mps: FloatArray
    error_sigma_mps2: float
    drift_sigma_mps: float

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return the velocities (m, 2) at some times, m/s."""
        return np.column_stack([np.interp(times_s, self.times_s, each) for each in self.velocities_mps.T])

    def ways_m(self, times_s: FloatArray) -> FloatArray:
        """Return from where (m, 2) it has come through the air since some times, m."""
        knots_s = np.unique(np.concatenate([times_s, self.times_s, [0.0]]))
        speeds = self.at(knots_s)
        steps_m = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(knots_s)[:, np.newaxis]
        gone_m = np.concatenate([np.zeros((1, 2)), np.cumsum(steps_m, axis=0)])
        index = np.searchsorted(knots_s, times_s)
        return np.asarray(gone_m[index] - gone_m[np.searchsorted(knots_s, 0.0)])


class MultilaterationProblem:
    """A denied vehicle's recent ranges, its peers' positions then, its heights; times count from `at_s`.

    `acceleration_sigma_mps2`: that of the vehicle meanwhile, east and north. Where it is known how it has `flown` through the
    air, only what that does not show is left of it, and the wind of its velocity.
    """

    def __init__(self, at_s: float, acceleration_sigma_mps2: float, flown: FlownThroughAir | None = None) -> None:
        self.at_s, self.flown = at_s, flown
        self.acceleration_sigma_mps2 = acceleration_sigma_mps2 if flown is None else flown.error_sigma_mps2
        self._rows: list[tuple[_Antennas, float, float, float, float, float, float, float]] = []
        self._heights: list[tuple[float, float, float]] = []

    def add_range(
        self,
        peer: int,
        near: PositionMeasurement,
        past: list[PositionMeasurement],
        m: RangeMeasurement,
        lasting_m2: float,
        turned_m: float,
    ) -> None:
        """Add a range with the position of its peer at that time.

        The position is extrapolated from `near`, the report nearest in time, by its velocity. Without one, the velocity is that
        of the `past` reports. `lasting_m2` is the variance of the lasting error of the pair. `turned_m` is the sigma of where a
        turn since that report may have led the peer.
        """
        velocity = near.velocity_enu_mps or _slope(past)
        step_s = m.measured_at_s - near.measured_at_s
        (e, n, u), (ve, vn, vu) = near.position_enu_m, velocity
        e, n, u = m.virtual_end(peer, (e + ve * step_s, n + vn * step_s, u + vu * step_s))
        peer_sigma_m = math.sqrt(near.sigma_h_m**2 + lasting_m2 + turned_m**2)
        antennas = peer, m.device_id if any(m.offset_enu_m) else 0
        self._rows.append((antennas, m.measured_at_s - self.at_s, e, n, u, m.range_m, m.sigma_m, peer_sigma_m))

    def add_altitude(self, m: AltitudeMeasurement) -> None:
        """Add a height of the denied vehicle itself."""
        self._heights.append((m.measured_at_s - self.at_s, m.up_m, m.sigma_m))

    def peers(self) -> Counter[int]:
        """Return the number of ranges with each peer."""
        return Counter(peer for (peer, _), *_ in self._rows)

    def antennas_of_a_peer(self) -> int:
        """Return to how many antennas of one peer, or with how many of its own, the vehicle ranges at most."""
        return max(Counter(peer for peer, _ in {row[0] for row in self._rows}).values())

    def to_fit(self) -> RangesToFit:
        """Return what is to be fitted."""
        place, prior_sigmas = self._motion()
        peers = np.array([peer for (peer, _), *_ in self._rows])
        return RangesToFit(self._ranges(), peers, self._heights_to_fit(), place, prior_sigmas)

    def _ranges(self) -> FloatArray:
        """Return the ranges (n, 6): time, s, and the peer's east, north and up, range and sigma, m.

        The sigmas are inflated so that the coloured error of a peer counts once in all its ranges. With lever arms it counts once
        for each antenna: what their ranges differ by tells of the side of the peers, and so does a wrong attitude.
        """
        counts = Counter(row[0] for row in self._rows)
        rows = np.array(
            [
                (t, e, n, u, r, math.sqrt(sigma**2 + counts[antennas] * peer_sigma**2))
                for antennas, t, e, n, u, r, sigma, peer_sigma in self._rows
            ]
        )
        if self.flown is not None:
            # As seen from where the air has carried it: there it only drifts.
            rows[:, 1:3] -= self.flown.ways_m(rows[:, 0])
        return rows

    def straight_m2(self) -> float:
        """Return the variance up to which a height is known well enough to linearise ranges, m^2.

        The height is across the lines of sight.
        """
        return min(2.0 * _STRAIGHT * range_m * sigma_m for *_, range_m, sigma_m, _ in self._rows)

    def _heights_to_fit(self) -> FloatArray:
        """Return the heights (m, 3): time, s, height, sigma, m; they are coloured: together worth one."""
        inflation = math.sqrt(max(len(self._heights), 1))
        return np.array([(t, u, sigma * inflation) for t, u, sigma in self._heights], dtype=np.float64).reshape(-1, 3)

    def _motion(self) -> tuple[FloatArray, FloatArray]:
        """Return the matrices (n, 3, k) from the unknowns to the position at each range, and the priors (k,).

        The unknowns are position and velocity at `at_s`, m and m/s, then the east and north accelerations in each stretch of
        time before, m/s^2. The priors are 1-sigmas, infinite for none.
        """
        t = np.array([row[1] for row in self._rows])
        stretches = max(math.ceil(-float(t.min()) / _STRETCH_S), 1)
        place = np.zeros((len(t), 3, 6 + 2 * stretches))
        place[:, range(3), range(3)] = 1.0
        place[:, range(3), range(3, 6)] = t[:, np.newaxis]
        for i in range(stretches):
            ended, began = np.maximum(-i * _STRETCH_S - t, 0.0), np.maximum(-(i + 1) * _STRETCH_S - t, 0.0)
            place[:, 0, 6 + 2 * i] = place[:, 1, 7 + 2 * i] = 0.5 * (ended**2 - began**2)
        east_mps, north_mps, up_mps = _VELOCITY_PRIOR_MPS
        if self.flown is not None:
            east_mps = north_mps = self.flown.drift_sigma_mps
        accelerations = [self.acceleration_sigma_mps2] * (2 * stretches)
        return place, np.array([math.inf, math.inf, _HEIGHT_PRIOR_M, east_mps, north_mps, up_mps, *accelerations])


def _slope(past: list[PositionMeasurement]) -> tuple[float, float, float]:
    if len(past) < 2:
        return (0.0, 0.0, 0.0)
    t = np.array([m.measured_at_s for m in past])
    t = t - t.mean()
    z = np.array([m.position_enu_m for m in past])
    spread = float(t @ t)
    e, n, u = ((t @ z) / spread).tolist() if spread > 0.0 else (0.0, 0.0, 0.0)
    return (e, n, u)


class Solution(NamedTuple):
    """Mean (6,) and covariance (6, 6) of position and velocity at the problem's time.

    `left_out` are the peers whose devices are faulty: without them the ranges agree.
    """

    mean: FloatArray
    covariance: FloatArray
    left_out: frozenset[int]


def solve_multilateration(problem: MultilaterationProblem, limit_sigma_m: float) -> Solution | Unlocated:
    """Return where the vehicle is, or the reason why that is unknown.

    `limit_sigma_m` is the largest horizontal sigma that counts as determined.
    """
    peers = problem.peers()
    if len(peers) < LEAST_PEERS or sum(peers.values()) < LEAST_RANGES:
        return Unlocated(NoEstimateReason.FEW_RANGES, sum(peers.values()), len(peers))
    found = fit_without_faulty(problem.to_fit())
    if found is None:
        return Unlocated(NoEstimateReason.CONTRADICTORY)
    (x, cost, normal, best), left_out = found
    # Antennas share the error of their peer: all of them tell of the place no better than one.
    covariance = np.linalg.inv(normal[best])[:6, :6] * problem.antennas_of_a_peer()
    worst_m = horizontal_sigma_m(covariance)
    if worst_m > limit_sigma_m:
        return Unlocated(NoEstimateReason.UNDETERMINED, worst_m)
    mean = x[best, :6]
    if problem.flown is not None:
        mean[3:5] += problem.flown.at(np.zeros(1))[0]
    for other in np.flatnonzero(cost < cost[best] + _CLEARLY_WORSE):
        d = x[other, :6] - x[best, :6]
        apart = d[:2] @ np.linalg.solve(covariance[:2, :2], d[:2])
        if apart > _DISTINCT_NIS:
            return Unlocated(NoEstimateReason.OTHER_PLACE, math.hypot(d[0], d[1]))
        half = 0.5 * abs(d[2])
        if half > math.sqrt(covariance[2, 2]):
            # Above or below: the height between both, as uncertain as they are apart.
            mean = mean.copy()
            mean[2] += 0.5 * d[2]
            covariance = covariance.copy()
            covariance[2, 2] += half * half
    return Solution(mean, covariance, left_out)
