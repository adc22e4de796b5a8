"""Lasting errors of a denied vehicle's ranges, observed in what no position explains.

See docs/explanation/range-biases.md.

In a window of a second the vehicle is somewhere on a parabola. Whatever position, velocity and acceleration explain is left to
them; the rest of the residuals, as far as the geometry leaves any, is information on the lasting error of each pair, eq. (31).
It adds up over the windows. So a bias that a position error explains as well is never learned: with few or badly placed peers
the filter stays as it is. Which biases there are is decided by the marginal likelihood, eq. (32): none, one of the vehicle's
device, one of each pair, or both.

Source: K.-R. Koch, Parameter Estimation and Hypothesis Testing in Linear Models (1999), sections 3.4 (nuisance parameters) and
3.6 (variance components).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_WINDOW_S = 1.0  # chosen: within a second a vehicle's path is a parabola; ranges to several peers at 5 Hz are enough for it
_CORRELATED_WINDOWS = 5  # chosen: multipath of one window is in the next ones too; five of them say no more than one
_MEMORY_S = 1200.0  # chosen: a bias changes with temperature and the attitude of the antenna; twenty minutes are one flight
_TEST_EVERY = 4  # chosen: windows between two tests, each of which costs a fifth of a millisecond
_LEAST_WINDOWS = 8  # chosen: two tests; of fewer windows a slow error looks like a lasting one
_MOST_SAMPLES = 256  # chosen: bounds the cost of a window; eight peers at 32 Hz
_FOUND_LOG_RATIO = 12.0  # chosen: odds of 160,000 that there is a bias; as the odds that decide between two sides of the peers
_LOST_LOG_RATIO = 3.0  # chosen: below it a bias that was found is no longer believed
_SIGMAS_M = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Chosen: biases from half a wavelength of ultra-wideband to uncalibrated devices, each twice the one before."""
_LEAST_OBSERVED = 0.1
"""Chosen: a combination of biases counts as observed with a tenth of the information on the best observed one."""
_GRID_M = [(device_m, pair_m) for device_m in _SIGMAS_M for pair_m in _SIGMAS_M]
"""Sigmas of the bias of a device and of that of each pair; the first is none."""
_CHANGES = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 23.0, 32.0, 45.0, 64.0)
"""How large the errors of pairs may be, as multiples of what is presumed; chosen: up to 4.5 m, as the largest of `_SIGMAS_M`."""
_CHANGE_LOG_RATIO = 3.0
"""Chosen: odds of twenty; that errors are larger than presumed costs no more than a wider bound."""
_NO_HEIGHT_M2 = 1e-9  # chosen: far below the variance of any range
_MOST_PAIRS = 24  # chosen: bounds the cost; as three times the peers in use
_DIFFUSE_M = 1e3  # chosen: far beyond the lasting error of any range
_ROUNDS = 3  # rounds of Gauss-Newton; chosen: the third changes nothing unless the start was metres off
_ACCELERATION_SIGMAS = 3.0  # chosen: the largest acceleration of a vehicle is three sigmas of it


Ranged = tuple[int, int]
"""Whom and how a vehicle ranges: the peer and the device that measures."""


class BiasSample(NamedTuple):
    """One range of a denied vehicle to a peer at `peer_m` that is not denied."""

    at_s: float
    peer: Ranged
    range_m: float
    white_m: float
    coloured_m: float
    peer_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BiasWindow:
    """The ranges of one window, and the state about which they are linearised.

    `mean` (6,) and `covariance` (6, 6) are of position and velocity when the window begins. `height_m2`: variance of the
    vehicle's own height, None without one. `max_mps2`: what the vehicle may accelerate.
    """

    at_s: float
    mean: FloatArray
    covariance: FloatArray
    height_m2: float | None
    max_mps2: float
    samples: tuple[BiasSample, ...] = ()

    @property
    def is_over_at_s(self) -> float:
        """When the window ends."""
        return self.at_s + _WINDOW_S

    def with_sample(self, sample: BiasSample) -> BiasWindow:
        """Return the window with one more range, if it has room."""
        return replace(self, samples=(*self.samples, sample)) if len(self.samples) < _MOST_SAMPLES else self


class UnknownBias(NamedTuple):
    """Sigmas of lasting errors that ranges have neither shown nor ruled out, m.

    One is that of the vehicle's device, the other that of each pair. They count once the latter is at least `telling_m`: coarse
    ranges do not tell of less.
    """

    device_m: float
    pair_m: float
    telling_m: float = 0.0


class PairBias(NamedTuple):
    """What is known of the lasting error of one pair, m."""

    mean_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class RangeBiases:
    """Information on the lasting errors of one vehicle's ranges. Immutable.

    `information` (k, k) and `vector` (k,) are of the pairs with `peers`, and of the vehicle's own height in the last place.
    `found`: what they are, under None that of a pair never ranged; None while there is no sign of any. `unknown`: what may be
    there unfound, None before the first window. `evidence`: log-likelihood of how large the errors of pairs are (`_CHANGES`).
    """

    at_s: float = -math.inf
    peers: tuple[Ranged, ...] = ()
    information: FloatArray = field(default_factory=lambda: np.zeros((1, 1)))
    vector: FloatArray = field(default_factory=lambda: np.zeros(1))
    windows: int = 0
    found: Mapping[Ranged | None, PairBias] | None = None
    unknown: UnknownBias | None = None
    evidence: FloatArray = field(default_factory=lambda: np.zeros(len(_CHANGES)))

    def bias(self, peer: Ranged | None) -> PairBias | None:
        """Return the lasting error of the pair with a peer, None while there is no sign of any."""
        return None if self.found is None else self.found.get(peer, self.found[None])

    def with_window(
        self, window: BiasWindow, peers_m2: Mapping[Ranged, FloatArray], least_m: float, presumed: UnknownBias | None
    ) -> RangeBiases:
        """Return the information after one more window, eq. (31), and what biases it shows.

        The biases are those found, eq. (32), and those that may be there unfound, eq. (38). `peers_m2` holds the covariance (3,
        3) of each peer's position, `least_m` is the sigma of a bias that is always there, `presumed` what may be there where
        nothing is known, if anything.
        """
        added = _information(window, self._mean_m)
        if added is None:
            return self
        names, M, y, units, _ = added
        base = self._with_peers(names)
        kept = math.exp(-max(window.at_s - self.at_s, 0.0) / _MEMORY_S) if self.windows else 1.0
        index = [*(base.peers.index(name) for name in names), len(base.peers)]
        information, vector = kept * base.information, kept * base.vector
        information[np.ix_(index, index)] += M / _CORRELATED_WINDOWS
        vector[index] += y / _CORRELATED_WINDOWS
        lasting_m2 = {name: float(u @ peers_m2[name] @ u) for name, u in zip(names, units, strict=True)}
        evidence = kept * self.evidence
        # Of coarse ranges, which seldom have such errors, one of the windows that say the same is looked at.
        every = 1 if presumed is None or presumed.telling_m == 0.0 else _CORRELATED_WINDOWS
        if presumed is not None and (self.windows + 1) % every == 0:
            told = self._evidence(added, lasting_m2, window.height_m2, least_m, presumed)
            evidence = evidence + every / _CORRELATED_WINDOWS * told
        after = replace(
            base, at_s=window.at_s, information=information, vector=vector, windows=self.windows + 1, evidence=evidence
        )
        unknown = None if presumed is None else presumed._replace(pair_m=after.change() * presumed.pair_m)
        if unknown is not None and unknown.pair_m < unknown.telling_m:
            unknown = None
        if after.windows < _LEAST_WINDOWS or after.windows % _TEST_EVERY:
            if unknown is None or self.unknown is None:
                return replace(after, unknown=unknown)
            return replace(after, unknown=self.unknown._replace(pair_m=unknown.pair_m))
        observed = _observe(after, lasting_m2, window.height_m2, least_m)
        left_m = max(least_m, unknown.pair_m if unknown is not None else 0.0)
        found = _find(after, observed, left_m, _left_share(presumed))
        return replace(after, found=found, unknown=_not_ruled_out(observed, unknown))

    def change(self) -> float:
        """Return the multiple of what is presumed that the errors of pairs were seen to be, eq. (45)."""
        best = int(np.argmax(self.evidence))
        return _CHANGES[best] if self.evidence[best] - self.evidence[0] > _CHANGE_LOG_RATIO else 1.0

    def _evidence(
        self,
        window: _Information,
        lasting_m2: Mapping[Ranged, float],
        height_m2: float | None,
        least_m: float,
        presumed: UnknownBias,
    ) -> FloatArray:
        """Return the log-likelihood of each of `_CHANGES` in one window, eq. (45)."""
        is_pair = np.array([1.0] * len(window.peers) + [0.0])
        mean = np.array([*map(self._mean_m, window.peers), 0.0])
        others = np.diag([*(lasting_m2[peer] + least_m**2 for peer in window.peers), height_m2 or _NO_HEIGHT_M2])
        if self.found is None:
            device_m = self.unknown.device_m if self.unknown is not None else presumed.device_m
            others = others + device_m**2 * np.outer(is_pair, is_pair)
        models = np.array([others + (change * presumed.pair_m) ** 2 * np.diag(is_pair) for change in _CHANGES])
        M, y = _well_observed(window.M, window.y, window.best)
        likelihood, _, _ = _log_likelihood(M, y - M @ mean, models)
        return likelihood

    def _mean_m(self, peer: Ranged) -> float:
        bias = self.bias(peer)
        return bias.mean_m if bias is not None else 0.0

    def _with_peers(self, names: Sequence[Ranged]) -> RangeBiases:
        """Return the same information with room for more peers; the oldest are forgotten beyond a limit."""
        new = [name for name in names if name not in self.peers]
        if not new:
            return self
        dropped = max(len(self.peers) + len(new) - _MOST_PAIRS, 0)
        gone = [name for name in self.peers if name not in names][:dropped]
        kept = [i for i, name in enumerate(self.peers) if name not in gone]
        peers = (*(self.peers[i] for i in kept), *new)
        size = len(peers) + 1
        information, vector = np.zeros((size, size)), np.zeros(size)
        old, place = [*kept, len(self.peers)], [*range(len(kept)), size - 1]
        information[np.ix_(place, place)] = self.information[np.ix_(old, old)]
        vector[place] = self.vector[old]
        return replace(self, peers=peers, information=information, vector=vector)


class _Information(NamedTuple):
    """What a window tells of the biases of k pairs and of the height.

    M is (k + 1, k + 1) and y is (k + 1,), with the height last. `units` (k, 3) are the directions from the peers to the vehicle.
    `best` is the information on the best known pair if the motion were known.
    """

    peers: list[Ranged]
    M: FloatArray
    y: FloatArray
    units: FloatArray
    best: float


def _information(window: BiasWindow, bias_m: Callable[[Ranged], float]) -> _Information | None:
    """Return what a window tells of biases, eq. (31); None for few ranges, or a peer at its place."""
    samples = window.samples
    peers = sorted({sample.peer for sample in samples})
    k, n = len(peers), len(samples)
    if n < 2 or k < 2:
        return None
    t = np.array([sample.at_s - window.at_s for sample in samples])[:, None]
    peer_m = np.array([sample.peer_m for sample in samples])
    range_m = np.array([sample.range_m for sample in samples])
    weight = np.array([sample.white_m for sample in samples]) ** -2.0
    P = window.covariance
    up_m2 = P.item(2, 2) if window.height_m2 is not None else _DIFFUSE_M**2
    acceleration_m2 = (window.max_mps2 / _ACCELERATION_SIGMAS) ** 2
    prior = np.diag(1.0 / np.array([_DIFFUSE_M**2, _DIFFUSE_M**2, up_m2, *P.diagonal()[3:6], *[acceleration_m2] * 3]))
    # H by the biases and, in the last column, by the height, which errs by the same in all windows.
    E = np.zeros((n, k + 1))
    E[np.arange(n), [peers.index(sample.peer) for sample in samples]] = 1.0
    biases_m = E[:, :k] @ np.array([bias_m(peer) for peer in peers])
    motion = np.zeros(9)
    for _ in range(_ROUNDS):
        # h and its Jacobian A by position, velocity and acceleration.
        d = window.mean[:3] + t * window.mean[3:] + motion[:3] + t * motion[3:6] + 0.5 * t * t * motion[6:] - peer_m
        distance = np.linalg.norm(d, axis=1)
        if float(distance.min()) <= 0.0:
            return None
        u = d / distance[:, None]
        A = np.concatenate([u, t * u, 0.5 * t * t * u], axis=1)
        AW, residual = A.T * weight, range_m - distance + A @ motion
        AA = AW @ A + prior
        motion = np.linalg.solve(AA, AW @ (residual - biases_m))
    if window.height_m2 is not None:
        E[:, k] = u[:, 2]
    AE, EW = AW @ E, E.T * weight
    gain = np.linalg.solve(AA, AE)
    M = EW @ E - AE.T @ gain
    y = EW @ residual - gain.T @ (AW @ residual)
    # A coloured error is the same throughout the window.
    C = np.diag([*(next(s.coloured_m for s in samples if s.peer == peer) ** 2 for peer in peers), 0.0])
    spread = np.linalg.inv(np.eye(k + 1) + M @ C)
    M, y = spread @ M, spread @ y
    units = E[:, :k].T @ u / E[:, :k].sum(axis=0)[:, None]
    weights = (EW @ E).diagonal()[:k]
    best = float((weights / (1.0 + weights * C.diagonal()[:k])).max())
    return _Information(peers, 0.5 * (M + M.T), y, units, best)


class _Observed(NamedTuple):
    """The information that is well observed, and the variances of what is no bias of a range.

    The information is `M` (k + 1, k + 1) and `y` (k + 1,). The variances are the diagonal of `others`. `is_pair` (k + 1,) is 0 in
    the last place, that of the height, else 1.
    """

    M: FloatArray
    y: FloatArray
    others: FloatArray
    is_pair: FloatArray


def _well_observed(M: FloatArray, y: FloatArray, best: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the information on the combinations of biases that have a tenth of the best information."""
    # What only small changes of the geometry tell from a position error would be learned from the errors of this model.
    values, modes = np.linalg.eigh(M)
    observed = modes[:, values > _LEAST_OBSERVED * (values[-1] if best is None else best)]
    return observed @ (observed.T @ M @ observed) @ observed.T, observed @ (observed.T @ y)


def _observe(biases: RangeBiases, lasting_m2: Mapping[Ranged, float], height_m2: float | None, least_m: float) -> _Observed:
    """Return the well observed part of the information."""
    M, y, k = biases.information, biases.vector, len(biases.peers)
    M, y = _well_observed(M, y)
    # What peers' positions and the own height err by lasts too, and is no bias.
    most_m2 = max(lasting_m2.values())
    others = np.diag([*(lasting_m2.get(peer, most_m2) + least_m**2 for peer in biases.peers), height_m2 or _NO_HEIGHT_M2])
    return _Observed(M, y, others, np.array([1.0] * k + [0.0]))


def _not_ruled_out(observed: _Observed, presumed: UnknownBias | None) -> UnknownBias | None:
    """Return the biases that may be there unfound, eq. (38), or None if none are presumed.

    The sigma of the device's bias holds its mean as well, because no range is corrected by that.
    """
    if presumed is None:
        return None
    M, y, others, is_pair = observed
    device_m2 = presumed.device_m**2
    T = others + device_m2 * np.outer(is_pair, is_pair) + presumed.pair_m**2 * np.diag(is_pair)
    told = np.linalg.solve(np.eye(len(M)) + M @ T, np.column_stack([y, M @ is_pair]))
    mean_m, variance_m2 = device_m2 * float(is_pair @ told[:, 0]), device_m2 - device_m2**2 * float(is_pair @ told[:, 1])
    return UnknownBias(math.sqrt(max(variance_m2, 0.0) + mean_m**2), presumed.pair_m)


def _log_likelihood(M: FloatArray, y: FloatArray, models: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the log-likelihood (g,) of the covariances T (g, k, k) of biases, eq. (32).

    With it come I + M T (g, k, k), and its inverse times y (g, k).
    """
    inner: FloatArray = np.eye(len(M)) + M @ models
    whole: FloatArray = np.asarray(
        np.linalg.solve(inner, np.broadcast_to(y[:, None], (len(models), len(M), 1)))[..., 0], dtype=np.float64
    )
    likelihood: FloatArray = 0.5 * np.einsum("i,gij,gj->g", y, models, whole) - 0.5 * np.linalg.slogdet(inner)[1]
    return likelihood, inner, whole


def _left_share(presumed: UnknownBias | None) -> float:
    """Return how much of a bias that was found may be left, as a share of it.

    As much as pairs of one device are presumed to differ; all of it where nothing is presumed or the ranges are coarse.
    """
    return 1.0 if presumed is None or presumed.telling_m > 0.0 else presumed.pair_m / presumed.device_m


def _find(biases: RangeBiases, observed: _Observed, left_m: float, left_share: float) -> Mapping[Ranged | None, PairBias] | None:
    """Return the likeliest biases, None where none are likely enough, eq. (32)."""
    M, y, others, is_pair = observed
    k = len(is_pair) - 1
    common, single = np.outer(is_pair, is_pair), np.diag(is_pair)
    models = [others + device_m**2 * common + pair_m**2 * single for device_m, pair_m in _GRID_M]
    likelihood, inner, whole = _log_likelihood(M, y, np.array(models))
    best = int(np.argmax(likelihood))
    if likelihood[best] - likelihood[0] < (_FOUND_LOG_RATIO if biases.found is None else _LOST_LOG_RATIO):
        return None
    # Covariances of the biases, last that of a pair never ranged, with those of the pairs.
    device_m, pair_m = _GRID_M[best]
    B = device_m**2 + pair_m**2 * np.eye(k + 1)[:, :k]
    mean = B @ whole[best, :k]
    variances = device_m**2 + pair_m**2 - np.einsum("ij,jk,ik->i", B, np.linalg.solve(inner[best], M)[:k, :k], B)
    # A bias changes with attitude and distance, and differs between pairs in ways that a position explains: how much, nothing
    # but its size tells.
    size_m = max(abs(float(mean[k])), math.sqrt(float(mean[:k] @ mean[:k]) / k))
    sigmas = np.sqrt(np.maximum(variances, max(left_m, left_share * size_m) ** 2))
    peers: tuple[Ranged | None, ...] = (*biases.peers, None)
    return {peer: PairBias(float(b), float(s)) for peer, b, s in zip(peers, mean, sigmas, strict=True)}
