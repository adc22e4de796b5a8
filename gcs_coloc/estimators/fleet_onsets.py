"""Manoeuvres that may have begun unnoticed: what they would have done to the states of a cluster, and how likely each is.

Where ranges tell little in a second, a hard turn takes a subject several sigmas away before its innovations show it. So for a
subject that tells no attitude it is held possible that a constant horizontal acceleration a began at one of a few recent times.
What it has done to the joint states since, S a, follows from the very propagations and corrections that their mean went through,
whatever its gains were; how well the innovations e = h S a + noise agree with it gives its likelihood. The joint density itself
stays that of the flight without it. Source: input estimation (Chan, Hu, Plant 1979), with a prior over the acceleration and its
onset in place of a test.

An acceleration lasts until it has changed the velocity by as much as the subject flies fast: a turn by a right angle or so.

All of it is kept in the joint array by the operations that it has anyway. The block of a subject's onsets is one of states
without an uncertainty of their own: its covariances with the others are S, its mean is the sum of (h S)' e / s^2 over the
measurements, and its own covariance less the sum of (h S)' h S / s^2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet_joint import Joint
from gcs_coloc.estimators.fleet_settings import FleetSettings

_SLOTS = 6
_SPACING_S = 1.5
_LIKELY = 0.5
_NEGLIGIBLE = 1e-3
_MOST_GAIN = 50.0

Onsets = tuple[float, ...]
"""When the manoeuvre of each slot began, s; infinite for an empty slot."""

NONE: Onsets = (math.inf,) * _SLOTS


class OnsetsOf(NamedTuple):
    """The key of the block of a vehicle's onsets, two states for each slot: acceleration to the east and to the north."""

    vehicle: int


class Shift(NamedTuple):
    """What manoeuvres that may have begun add to n states: to their mean (n,) and to their covariance (n, n)."""

    mean: FloatArray
    covariance: FloatArray


def renew(joint: Joint, vehicle: int, onsets: Onsets, s: FleetSettings) -> Onsets:
    """Hold it possible that a manoeuvre begins now, if it is time for that; the oldest onset gives way, or all that are likely.

    What is likely then goes into the joint density.
    """
    key, at_s = OnsetsOf(vehicle), joint.time_s[vehicle]
    if key not in joint.where:
        joint.append(key, np.zeros(2 * _SLOTS), np.zeros((2 * _SLOTS, 2 * _SLOTS)), at_s)
        onsets = NONE
    if any(at_s - _SPACING_S < onset < math.inf for onset in onsets):
        return onsets
    on = joint.where[key]
    slot = onsets.index(math.inf) if math.inf in onsets else onsets.index(min(onsets))
    weights = _weigh(joint, vehicle, s)
    if sum(weights.chances) > _LIKELY or (onsets[slot] < math.inf and weights.chances[slot] > _NEGLIGIBLE):
        shift = _shift(joint.A[1:, on], weights)
        joint.A[0, 1:] += shift.mean
        joint.A[1:, 0] = joint.A[0, 1:]
        joint.A[1:, 1:] += shift.covariance
        forget(joint, vehicle)
        onsets, slot = NONE, 0
    else:
        joint.clear(on.start + 2 * slot, on.start + 2 * slot + 2)
    return (*onsets[:slot], at_s, *onsets[slot + 1 :])


def push(joint: Joint, vehicle: int, onsets: Onsets, step_s: float, s: FleetSettings) -> None:
    """Let the accelerations that have begun act on a vehicle over a step, by which its states have just been propagated."""
    where, on = joint.where[vehicle], joint.where[OnsetsOf(vehicle)]
    S = joint.A[where.start : where.start + 6, on]
    _act(S, joint, vehicle, onsets, step_s, s)
    joint.A[on, where.start : where.start + 6] = S.T


def forget(joint: Joint, vehicle: int) -> None:
    """Hold no manoeuvre of a vehicle possible that began before now."""
    on = joint.where.get(OnsetsOf(vehicle))
    if on is not None:
        joint.clear(on.start, on.stop)


def shift_of(joint: Joint, vehicle: int, by: int, onsets: Onsets, step_s: float, s: FleetSettings) -> Shift:
    """Return what the onsets of the vehicle `by` add to the position and velocity, (6,), of a vehicle a step after its time."""
    where, on = joint.where[vehicle], joint.where[OnsetsOf(by)]
    S = joint.A[where.start : where.start + 6, on]
    if step_s != 0.0:
        S = S.copy()
        S[:3] += step_s * S[3:]
        if by == vehicle:
            _act(S, joint, vehicle, onsets, step_s, s)
    return _shift(S, _weigh(joint, by, s))


class _Weights(NamedTuple):
    """For each of the onsets (k,): its chance, the mean of its acceleration (east, north; m/s^2), and the covariance of that."""

    chances: FloatArray
    east: FloatArray
    north: FloatArray
    ee: FloatArray
    en: FloatArray
    nn: FloatArray


def _act(S: FloatArray, joint: Joint, vehicle: int, onsets: Onsets, step_s: float, s: FleetSettings) -> None:
    lasting_s = _speed_mps(joint, vehicle, s) / _acceleration_mps2(joint, vehicle, s)
    oldest_s = joint.time_s[vehicle] - lasting_s
    acting = np.array([step_s if oldest_s <= onset < math.inf else 0.0 for onset in onsets])
    for axis in (0, 1):
        S[axis, axis::2] += (0.5 * step_s) * acting
        S[axis + 3, axis::2] += acting


def _speed_mps(joint: Joint, vehicle: int, s: FleetSettings) -> float:
    """Return how much a vehicle may change its velocity at once: by as much as it has, or as a slow one has."""
    start = joint.where[vehicle].start
    return max(math.hypot(joint.A.item(0, start + 3), joint.A.item(0, start + 4)), s.slow_speed_mps)


def _acceleration_mps2(joint: Joint, vehicle: int, s: FleetSettings) -> float:
    return min(s.onset_acceleration_mps2, _speed_mps(joint, vehicle, s) / _SPACING_S)


def _weigh(joint: Joint, vehicle: int, s: FleetSettings) -> _Weights:
    A, on = joint.A, joint.where[OnsetsOf(vehicle)]
    prior = 1.0 / _acceleration_mps2(joint, vehicle, s) ** 2
    # The 2 by 2 of each slot by itself, in closed form: this is asked with every answer.
    diagonal, beside = A.diagonal()[on], A.diagonal(1)[on]
    ee, nn, en = prior - diagonal[::2], prior - diagonal[1::2], -beside[::2]
    det = ee * nn - en * en
    told_e, told_n = A[0, on.start : on.stop : 2], A[0, on.start + 1 : on.stop : 2]
    east, north = (nn * told_e - en * told_n) / det, (ee * told_n - en * told_e) / det
    gain = 0.5 * (told_e * east + told_n * north - np.log(det / prior**2))
    before = _SPACING_S * s.onset_rate_per_s
    odds = before * np.exp(np.minimum(gain, _MOST_GAIN))
    chances = odds / (1.0 - min(_SLOTS * before, 0.5) + odds.sum())
    return _Weights(chances, east, north, nn / det, -en / det, ee / det)


def _shift(S: FloatArray, w: _Weights) -> Shift:
    """Return the mean of the mixture of all onsets and of none, and what its covariance is beyond that of none; S (n, 2 k)."""
    east, north = S[:, ::2], S[:, 1::2]
    shifts = east * w.east + north * w.north
    mean = shifts @ w.chances
    half = (east * (0.5 * w.chances * w.ee) + north * (w.chances * w.en)) @ east.T
    half += (north * (0.5 * w.chances * w.nn)) @ north.T + (shifts * (0.5 * w.chances)) @ shifts.T
    half -= np.multiply.outer(0.5 * mean, mean)
    return Shift(mean, half + half.T)
