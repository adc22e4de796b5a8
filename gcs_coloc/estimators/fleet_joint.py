"""One Gaussian over the states of several vehicles, each at its own time.

Vehicles are disturbed independently of each other, so the joint density may hold every vehicle at a different time: to bring one
vehicle forward touches its own rows and columns only, and a measurement between two vehicles that corrects a third one through
their correlation corrects it at that third one's own (earlier) time, exactly. A measurement therefore costs one or two small
propagations and one rank-k update, whatever the number of vehicles.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from gcs_coloc.core.measurements import FloatArray

Key = Hashable


class Whitened(NamedTuple):
    """An innovation brought to unit variance: e (k,) = S^-1/2 innovation, with `inverse_root` S^-1/2 (k, k), lower triangular.

    `nis` is e'e, the normalised innovation squared.
    """

    e: FloatArray
    inverse_root: FloatArray
    nis: float


def whiten(S: FloatArray, innovation: FloatArray) -> Whitened:
    """Return the innovation (k,) whitened by its covariance S (k, k)."""
    root, info = lapack.dpotrf(S, lower=1, clean=1)
    assert info == 0, "an innovation covariance holds measurement noise and is positive definite"
    inverse_root, _ = lapack.dtrtri(root, lower=1)
    e = inverse_root @ innovation
    return Whitened(e, inverse_root, float(e @ e))


class Joint:
    """Mean `x` (n,) and covariance `P` (n, n) over named blocks of states.

    `start` maps each block's key to its first index, `size` to its length, `time_s` to the time at which its states hold.
    """

    __slots__ = ("P", "size", "start", "time_s", "x")

    def __init__(self) -> None:
        self.x: FloatArray = np.zeros(0)
        self.P: FloatArray = np.zeros((0, 0))
        self.start: dict[Key, int] = {}
        self.size: dict[Key, int] = {}
        self.time_s: dict[Key, float] = {}

    def copy(self) -> Joint:
        """Return an independent copy."""
        other = Joint()
        other.x = self.x.copy()
        other.P = self.P.copy()
        other.start = dict(self.start)
        other.size = dict(self.size)
        other.time_s = dict(self.time_s)
        return other

    def slice(self, key: Key) -> slice:
        """Return where a block lies in `x` and `P`."""
        start = self.start[key]
        return slice(start, start + self.size[key])

    def append(self, key: Key, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Append a block that is independent of all others: mean (m,), covariance (m, m), at its time."""
        n, m = len(self.x), len(mean)
        P = np.zeros((n + m, n + m))
        P[:n, :n] = self.P
        P[n:, n:] = covariance
        self.P = P
        self.x = np.concatenate([self.x, mean])
        self.start[key], self.size[key], self.time_s[key] = n, m, at_s

    def part(self, keys: list[Key]) -> Joint:
        """Return the marginal density of some blocks, in the order given."""
        other = Joint()
        index: list[int] = []
        for key in keys:
            other.start[key], other.size[key], other.time_s[key] = len(index), self.size[key], self.time_s[key]
            index.extend(range(self.start[key], self.start[key] + self.size[key]))
        other.x = self.x[index]
        other.P = self.P[np.ix_(index, index)]
        return other

    def join(self, other: Joint) -> None:
        """Take in the blocks of another density, independent of this one."""
        n, m = len(self.x), len(other.x)
        P = np.zeros((n + m, n + m))
        P[:n, :n] = self.P
        P[n:, n:] = other.P
        self.P = P
        self.x = np.concatenate([self.x, other.x])
        for key, start in other.start.items():
            self.start[key], self.size[key], self.time_s[key] = n + start, other.size[key], other.time_s[key]

    def transform(self, key: Key, mean: FloatArray, F: FloatArray, Q: FloatArray, at_s: float) -> None:
        """Bring one block to time `at_s`: its mean (m,) there, the Jacobian F (m, m) of the way and its noise Q (m, m)."""
        where = self.slice(key)
        self.x[where] = mean
        rows = F @ self.P[where]
        block = rows[:, where] @ F.T + Q
        self.P[where] = rows
        self.P[:, where] = rows.T
        self.P[where, where] = 0.5 * (block + block.T)
        self.time_s[key] = at_s

    def update(self, PHt: FloatArray, innovation: Whitened) -> FloatArray:
        """Take a measurement of k values: PHt (n, k) = P H' and its whitened innovation.

        The covariance is reduced by W W' with W = P H' S^-T/2 (n, k), which stays symmetric to the last bit. Returns W.
        """
        W: FloatArray = PHt @ innovation.inverse_root.T
        self.x += W @ innovation.e
        self.P -= W @ W.T
        return W

    def update_scalar(self, PHt: FloatArray, variance: float, innovation: float) -> FloatArray:
        """Take a measurement of one value: PHt (n,), innovation variance and innovation. Returns W (n,) as `update` does."""
        root = float(np.sqrt(variance))
        W: FloatArray = PHt * (1.0 / root)
        self.x += W * (innovation / root)
        self.P -= W[:, np.newaxis] * W
        return W
