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
from scipy.linalg import blas, lapack

from gcs_coloc.core.measurements import FloatArray

Key = Hashable


class Whitened(NamedTuple):
    """A measurement of k values brought to innovations of unit variance and independent of each other.

    `W` (1 + n, k) holds their covariances with the states from row 1 on, and less these innovations in row 0: what
    `JointState.correct` takes. `nis` is the sum of their squares, the normalised innovation squared.
    """

    W: FloatArray
    nis: float

    def innovations(self) -> list[float]:
        """The k innovations of unit variance."""
        return [-e for e in self.W[0].tolist()]


def whiten(HA: FloatArray, S: FloatArray) -> Whitened:
    """Return k measured values whitened by the covariance S (k, k) of their innovations.

    HA (k, 1 + n) holds their covariances with all states, and in column 0 what was expected less what was measured.
    """
    root, info = lapack.dpotrf(S.T, lower=1, clean=1)
    assert info == 0, "an innovation covariance holds measurement noise and is positive definite"
    # For so few values the inverse of the root is quicker than to solve with it.
    inverse, _ = lapack.dtrtri(root, lower=1)
    W = blas.dgemm(1.0, HA.T, inverse, trans_b=1)
    e = W[0]
    return Whitened(W, float(e @ e))


class JointState:
    """Mean and covariance of n states in named blocks, in one array.

    `A` (1 + n, 1 + n) is the covariance with the mean before it: in row 0, and the same in column 0; its corner means nothing.
    So one product gives the covariances of a combination of states with all of them and its mean, and one rank-k update
    corrects covariance and mean. It is symmetric to the last bit where the BLAS computes both halves in the same way, else
    to rounding, which does not grow: whatever brings a block forward makes it symmetric.

    `where` maps each block's key to where it lies in `A`, `time_s` to the time at which its states hold.
    """

    __slots__ = ("A", "time_s", "where")

    def __init__(self) -> None:
        self.A: FloatArray = np.zeros((1, 1))
        self.where: dict[Key, slice] = {}
        self.time_s: dict[Key, float] = {}

    def copy(self) -> JointState:
        """Return an independent copy."""
        other = object.__new__(JointState)
        other.A = self.A.copy()
        other.where = self.where.copy()
        other.time_s = self.time_s.copy()
        return other

    def mean(self, key: Key) -> FloatArray:
        """Return the mean (m,) of a block: a view, not to be written to."""
        return self.A[0, self.where[key]]

    def covariance(self, key: Key) -> FloatArray:
        """Return the covariance (m, m) of a block: a view."""
        where = self.where[key]
        return self.A[where, where]

    def augment(self, key: Key, mean: FloatArray, covariance: FloatArray, at_s: float) -> None:
        """Append a block that is independent of all others: mean (m,), covariance (m, m), at its time."""
        n, m = len(self.A), len(mean)
        self._extend(m)
        self.A[0, n:] = self.A[n:, 0] = mean
        self.A[n:, n:] = covariance
        self.where[key], self.time_s[key] = slice(n, n + m), at_s

    def marginalise(self, keys: list[Key]) -> JointState:
        """Return the marginal density of some blocks, in the order given."""
        other = JointState()
        index = [0]
        for key in keys:
            first, where = len(index), self.where[key]
            index.extend(range(where.start, where.stop))
            other.where[key], other.time_s[key] = slice(first, len(index)), self.time_s[key]
        other.A = self.A[np.ix_(index, index)]
        return other

    def augment_with(self, other: JointState) -> None:
        """Take in the blocks of another density, independent of this one."""
        n = len(self.A)
        self._extend(len(other.A) - 1)
        self.A[0, n:] = self.A[n:, 0] = other.A[0, 1:]
        self.A[n:, n:] = other.A[1:, 1:]
        for key, where in other.where.items():
            self.where[key] = slice(n + where.start - 1, n + where.stop - 1)
        self.time_s.update(other.time_s)

    def _extend(self, m: int) -> None:
        n = len(self.A)
        A = np.zeros((n + m, n + m))
        A[:n, :n] = self.A
        self.A = A

    def propagate(self, key: Key, mean: tuple[float, ...], F: FloatArray, Q: FloatArray, at_s: float) -> None:
        """Bring one block to time `at_s`: the Jacobian F (m, m) of the way, its noise Q (m, m), and the mean there.

        `mean` may be shorter than m: the rest goes by F.
        """
        A, where = self.A, self.where[key]
        columns = blas.dgemm(1.0, A[where].T, F.T)
        rows = columns.T
        rows[: len(mean), 0] = mean
        half = blas.dgemm(0.5, columns[where], F.T, beta=0.5, c=Q.T, trans_a=1)
        A[where] = rows
        A[:, where] = columns
        np.add(half, half.T, out=A[where, where])
        self.time_s[key] = at_s

    def predict_block_measurement(self, key: Key, H: FloatArray) -> FloatArray:
        """Return (k, 1 + n): the mean, then the covariances with all states, of the combinations H (k, m) of a block's states."""
        HA: FloatArray = blas.dgemm(1.0, self.A[self.where[key]].T, H.T).T
        return HA

    def predict_measurement(self, G: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is expected of the combinations G (k, 1 + n) of all states, column 0 of it zero.

        That is their mean and their covariances with all states, (k, 1 + n), and those among themselves, (k, k).
        """
        columns = blas.dgemm(1.0, self.A.T, G.T)
        return columns.T, blas.dgemm(1.0, columns, G.T, trans_a=1)

    def correct(self, W: FloatArray) -> None:
        """Take whitened measurements, W (1 + n, k) of `Whitened`: the covariance is reduced by W W', which keeps it symmetric."""
        blas.dgemm(-1.0, W, W, beta=1.0, c=self.A.T, trans_b=1, overwrite_c=1)

    def correct_scalar(self, hA: FloatArray, variance: float) -> FloatArray:
        """Take one measured value, hA (1 + n,) as a row of `whiten`, with its innovation's variance; return W (1 + n, 1)."""
        W: FloatArray = (hA * (1.0 / variance**0.5))[:, np.newaxis]
        self.correct(W)
        return W

    def scale(self, first: int, stop: int, factor: float) -> None:
        """Scale neighbouring states, mean and covariances, by one factor."""
        rows, columns = self.A[first:stop], self.A[:, first:stop]
        rows *= factor
        columns *= factor

    def decay(self, key: Key, decays: tuple[float, float], sigmas: tuple[float, float]) -> None:
        """Let a block of two first-order Gauss-Markov states fade by their factors towards zero, with their spreads `sigmas`."""
        A, i, (di, dj), (si, sj) = self.A, self.where[key].start, decays, sigmas
        j = i + 1
        variance_i, covariance, variance_j = A.item(i, i), A.item(i, j), A.item(j, j)
        # One by one: to scale and to write both at once takes twice the time.
        for k, decay in ((i, di), (j, dj)):
            row = A[k]
            row *= decay
            A[:, k] = row
        A[i, i] = di * di * variance_i + si * si * (1.0 - di * di)
        A[j, j] = dj * dj * variance_j + sj * sj * (1.0 - dj * dj)
        A[i, j] = A[j, i] = di * dj * covariance
