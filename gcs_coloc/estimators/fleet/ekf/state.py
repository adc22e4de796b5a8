"""The joint state of several vehicles: what its components are, and the Gaussian density over them.

Each vehicle's block holds at the vehicle's own time. Vehicles are disturbed independently of each other, so propagating one
touches its own rows and columns only, and a measurement between two vehicles corrects a third one through their correlation
at that one's own, earlier time, exactly. A measurement costs one or two small propagations and one rank-k update.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, lapack

from gcs_coloc.core.measurements import FloatArray

# Components of one vehicle's block, eq. (1) of docs/explanation/fleet-filter.md. A static anchor's block is its position alone.
POSITION = slice(0, 3)
"""Position p east, north, up, m; integrates the velocity, eq. (4). It holds by the vehicle's own clock, eq. (10)."""
VELOCITY = slice(3, 6)
"""Velocity v over ground east, north, up, m/s; turns at a rate and is disturbed by white acceleration, eq. (3) and (6)."""
WIND = slice(6, 8)
"""Horizontal wind w east, north, m/s; Gauss-Markov, eq. (7), as are all components below."""
AIRSPEED_ERROR = 8
"""Error b_V of the airspeed, m/s."""
HEADING_ERROR = 9
"""Error b_psi of the heading, rad."""
BARO_ERROR = 10
"""Error b_h of the barometric height, m."""
REPORT_ERROR = slice(11, 14)
"""Error b_p of the position reports east, north, up, m."""
TIME_STAMP_OFFSET = 14
"""Offset tau of the vehicle's time stamps, s: what it reports was measured this much later than its stamp says."""
TURN = 15
"""Turn rate omega, rad/s, clockwise."""
SIZE = 16
"""Number of components of a moving vehicle."""

PairKey = tuple[int, int, int]
"""Key of the block of a ranging pair: both vehicles and the device."""
Key = Hashable
"""Key of a block: a vehicle's system id, `pair_key` for the two range errors of a ranging pair, or an `UnknownKey`."""


def ends(key: Key) -> tuple[int, int]:
    """Return the two vehicles of a block; both are the same where it is of one vehicle alone."""
    if isinstance(key, UnknownKey):
        return key.a, key.b
    return key[:2] if isinstance(key, tuple) else (key, key)


def pair_key(a: int, b: int, device: int) -> PairKey:
    """Return the key of a pair's bias b and coloured error c, eq. (14), the same for both directions."""
    return (a, b, device) if a < b else (b, a, device)


@dataclass(frozen=True, slots=True)
class UnknownKey:
    """Key of the sensitivities of all states to an unknown bias of a denied vehicle's ranges.

    The bias is that of a pair, or of the vehicle's device. `a` and `b` are the pair, for the device both the vehicle itself.
    """

    a: int
    b: int
    denied_vehicle: int

    @property
    def is_of_device(self) -> bool:
        """Whether the bias is that of the vehicle's device."""
        return self.a == self.b


class Whitened(NamedTuple):
    """A measurement of k values whose innovations are whitened: independent, of unit variance, eq. (19).

    `W` (1 + n, k) is what `JointState.correct` needs: minus the whitened innovations in row 0, below them their covariances
    with the states. `nis` is the normalised innovation squared, nu' S^-1 nu.
    """

    W: FloatArray
    nis: float

    def innovations(self) -> list[float]:
        """The k whitened innovations."""
        return [-e for e in self.W[0].tolist()]


def whiten(HA: FloatArray, S: FloatArray) -> Whitened:
    """Whiten k measured values by their innovation covariance S (k, k), eq. (19).

    HA (k, 1 + n) holds minus the innovation in column 0, then the covariances H P of the prediction with all states.
    """
    root, info = lapack.dpotrf(S.T, lower=1, clean=1)
    assert info == 0, "an innovation covariance holds measurement noise and is positive definite"
    # For so few values the inverse of the root is quicker than solving with it.
    inverse, _ = lapack.dtrtri(root, lower=1)
    W = blas.dgemm(1.0, HA.T, inverse, trans_b=1)
    e = W[0]
    return Whitened(W, float(e @ e))


class JointState:
    """Mean and covariance of n states in named blocks, in one array.

    `A` (1 + n, 1 + n) is the covariance, with the mean before it in row 0 and column 0; A[0, 0] means nothing. So one product
    gives the mean of a combination of states and its covariances with all of them, and one rank-k update corrects both.
    It is symmetric to the last bit where the BLAS computes both halves alike, else to rounding that does not grow: each
    propagation makes its block symmetric.

    `where` is the slice of each block in `A`, `time_s` the time at which its states hold.
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
        """Augment by a block that is independent of all others: mean (m,), covariance (m, m), at its time."""
        n, m = len(self.A), len(mean)
        self._extend(m)
        self.A[0, n:] = self.A[n:, 0] = mean
        self.A[n:, n:] = covariance
        self.where[key], self.time_s[key] = slice(n, n + m), at_s

    def marginalise(self, keys: list[Key]) -> JointState:
        """Marginalise: return the density of some blocks, in the order given."""
        other = JointState()
        index = [0]
        for key in keys:
            first, where = len(index), self.where[key]
            index.extend(range(where.start, where.stop))
            other.where[key], other.time_s[key] = slice(first, len(index)), self.time_s[key]
        other.A = self.A[np.ix_(index, index)]
        return other

    def augment_with(self, other: JointState) -> None:
        """Augment by the blocks of another density, independent of this one."""
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
        """Propagate one block to `at_s`: P = F P F' + Q (m, m); F propagates what a shorter `mean` lacks."""
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
        """Return (k, 1 + n), the mean H x and the covariances H P with all states, for H (k, m) on one block."""
        HA: FloatArray = blas.dgemm(1.0, self.A[self.where[key]].T, H.T).T
        return HA

    def predict_measurement(self, H: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (k, 1 + n), the mean H x and the covariances H P with all states, and H P H' (k, k).

        H (k, 1 + n) is the Jacobian by all states; its column 0 is zero.
        """
        columns = blas.dgemm(1.0, self.A.T, H.T)
        return columns.T, blas.dgemm(1.0, columns, H.T, trans_a=1)

    def correct(self, W: FloatArray) -> None:
        """Correct with whitened measurements: A = A - W W', eq. (19), which keeps A symmetric.

        `W` (1 + n, k) is that of `Whitened`.
        """
        blas.dgemm(-1.0, W, W, beta=1.0, c=self.A.T, trans_b=1, overwrite_c=1)

    def correct_scalar(self, hA: FloatArray, variance: float) -> FloatArray:
        """Correct with one value, and return W (1 + n, 1) of the correction.

        `hA` (1 + n,) is a row of `HA` as `whiten` needs it. `variance` is that of the innovation.
        """
        W: FloatArray = (hA * (1.0 / variance**0.5))[:, np.newaxis]
        self.correct(W)
        return W

    def restore(self, considered: list[int], W: FloatArray) -> None:
        """Undo what a correction has done to mean and covariance of considered states, eq. (33).

        `considered` holds the indices of these states. `W` (1 + n, 1) is that of the correction. Their covariances with all other
        states stay corrected (Schmidt 1966; Jazwinski 1970, section 8.4).
        """
        A, mine = self.A, W[considered, 0]
        A[np.ix_(considered, considered)] += mine[:, None] * mine
        back = W.item(0, 0) * mine
        A[0, considered] += back
        A[considered, 0] += back

    def add_sensitivity(self, unknown: Sequence[tuple[UnknownKey, float]], W: FloatArray, sigma_m: float) -> None:
        """Apply a correction by one value to the sensitivities to unknown errors, eq. (38).

        `unknown` holds the key of each error and its share in the value. `W` (1 + n, 1) and `sigma_m` are those of the
        correction, which has treated them as it treats covariances. What stands where two of them meet, or in row 0, means
        nothing.
        """
        for key, share in unknown:
            i = self.where[key].start
            self.A[1:, i] -= (share / sigma_m) * W[1:, 0]
            self.A[i, 1:] = self.A[1:, i]

    def scale(self, first: int, stop: int, factor: float) -> None:
        """Scale the states from `first` to before `stop`, mean and covariances, by one factor."""
        rows, columns = self.A[first:stop], self.A[:, first:stop]
        rows *= factor
        columns *= factor

    def decay(self, key: Key, decays: tuple[float, float], sigmas: tuple[float, float]) -> None:
        """Propagate a block of two Gauss-Markov states, eq. (7).

        `decays` are their decay factors over the step, and `sigmas` their steady-state sigmas.
        """
        A, i, (di, dj), (si, sj) = self.A, self.where[key].start, decays, sigmas
        j = i + 1
        variance_i, covariance, variance_j = A.item(i, i), A.item(i, j), A.item(j, j)
        # One by one: scaling and writing both at once takes twice the time.
        for k, decay in ((i, di), (j, dj)):
            row = A[k]
            row *= decay
            A[:, k] = row
        A[i, i] = di * di * variance_i + si * si * (1.0 - di * di)
        A[j, j] = dj * dj * variance_j + sj * sj * (1.0 - dj * dj)
        A[i, j] = A[j, i] = di * dj * covariance
