"""Position search: a sum of Gaussians for a denied vehicle too uncertain to linearise its ranges.

It keeps every side of the peers open. A range to a peer leaves a circle. Where the uncertainty across the line of sight is large
against the range, one Gaussian cannot follow it, and the side on which it is linearised is confirmed for ever. So the state
becomes a sum of Gaussians along the circle, eq. (27), each of which is small enough to be linearised (Alspach and Sorenson 1972;
for ranges, Djugash 2009). Later ranges decide between them; with one left, the joint filter goes on from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.search.gaussian_mixture import (
    GATE_NIS,
    MOST_SPLIT,
    log_sum,
    merged,
    moments,
    pruned,
    range_points,
    tail_merged,
    update,
    with_more_noise,
)

_TOO_WIDE = 4.0
_NARROW = 1.4
"""Chosen: a horizontal variance of so many times distance times range sigma begins and ends a search. At 1.4 the bend of the
circle moves a range by its sigma."""
_WIDE_SHARE = 0.5  # chosen: a sigma of half the distance on each axis; a narrower state stays on its side of the peer
_LEAST_SIGMAS = 10.0  # chosen: a shorter range has no side; it ends a search no sooner and begins none
_SPLIT = 2.0  # chosen: a component is split where its variance is so many times distance times range sigma
_OTHERS_SHARE = 1e-4
"""Chosen: other places with less than this share together are excluded; a wrong decision is confident and lasts."""
_LEAST_SHARE = 1e-6  # chosen: components below it link no places
_LINKED = 4.0  # chosen: neighbours on a circle, one sigma apart, are linked, and those three sigmas apart are not
_LEAST_RANGES = 12  # chosen: with fewer ranges one that is reflected may decide between two places
_LEAST_AGREED = 2  # chosen: so many ranges in a row must leave one place; a single one that is an outlier may fit a wrong one
_REFUSED_MOST = 10  # chosen: when so many ranges in a row fit no component, none of them is the vehicle's place
_FALSE_NIS = 100.0
"""Chosen: a range ten sigmas from a wide component is false; one within them may be of a manoeuvre, and moves it."""
_LEAST_DISTANCE_M = 0.1  # chosen: nearer, two antennas have no direction to each other
_ROUNDING_M2 = 1e-12  # chosen: keeps a quotient finite; far below any variance


def is_too_wide(horizontal_m2: float, distance_m: float, range_sigma_m: float) -> bool:
    """Return whether a horizontal variance is too large to linearise a range.

    `horizontal_m2` is the sum of both axes. It is too large where the circle bends by more than the range's sigma, and the other
    side of the peer is within reach.
    """
    distance_m = max(distance_m, _LEAST_SIGMAS * range_sigma_m)
    return horizontal_m2 > max(_TOO_WIDE * range_sigma_m, _WIDE_SHARE * distance_m) * distance_m


@dataclass(frozen=True, slots=True)
class RangeCircle:
    """One range to a peer with a known position.

    `position_m` (3,) and `covariance_m2` (3, 3) are those of the peer. `variance_m2` is the white variance of the range.
    """

    peer: int
    position_m: FloatArray
    covariance_m2: FloatArray
    range_m: float
    variance_m2: float


@dataclass(frozen=True, slots=True)
class PositionSearch:
    """A sum of k Gaussians of position and velocity at a time. Immutable: every step returns a new one.

    `mean` (k, 6), `covariance` (k, 6, 6), `log_weight` (k,), the largest 0. `other_mean` (10,) and `other_covariance` (10, 10)
    are the rest of the states, which go on unchanged. `uses` counts the ranges with each peer, `agreed` those in a
    row after which one place was left.
    """

    at_s: float
    mean: FloatArray
    covariance: FloatArray
    log_weight: FloatArray
    other_mean: FloatArray
    other_covariance: FloatArray
    uses: Mapping[int, int]
    refused: int = 0
    agreed: int = _LEAST_AGREED

    @staticmethod
    def of_state(mean: FloatArray, covariance: FloatArray, at_s: float) -> PositionSearch:
        """Return the search that begins with one vehicle's mean (16,) and covariance (16, 16)."""
        P = covariance.copy()
        return PositionSearch(at_s, mean[None, :6].copy(), P[None, :6, :6], np.zeros(1), mean[6:].copy(), P[6:, 6:], {})

    def joined(self, others: Sequence[tuple[PositionSearch, float]]) -> PositionSearch:
        """Return the search at the places of this and of others, each with its log odds against this one."""
        parts = [(self, 0.0), *others]
        w = np.concatenate([search.log_weight - log_sum(search.log_weight) + odds for search, odds in parts])
        x, P = (np.concatenate(each) for each in zip(*((search.mean, search.covariance) for search, _ in parts), strict=True))
        x, P, w = merged(*pruned(x, P, w - w.max()))
        found = replace(self, mean=x, covariance=P, log_weight=w)
        return replace(found, agreed=self.agreed if found.place() is not None else 0)

    @property
    def is_open(self) -> bool:
        """Whether several places fitted lately: time does not make them one, and one range may be an outlier."""
        return self.agreed < _LEAST_AGREED

    @property
    def is_lost(self) -> bool:
        """Whether too many ranges in a row fitted no component."""
        return self.refused >= _REFUSED_MOST

    def predicted(self, at_s: float, densities_m2ps3: tuple[float, float], speeds_mps: tuple[float, float]) -> PositionSearch:
        """Return the search at a later time, eq. (28); densities and speeds are horizontal and vertical."""
        step_s = at_s - self.at_s
        if step_s <= 0.0:
            return self
        F, Q = np.eye(6), np.zeros((6, 6))
        for axis in range(3):
            density, speed_mps = densities_m2ps3[axis // 2], speeds_mps[axis // 2]
            F[axis, axis + 3] = step_s
            F[axis + 3, axis + 3] = math.exp(-0.5 * step_s * density / speed_mps**2)
            Q[axis, axis] = density * step_s**3 / 3.0
            Q[axis, axis + 3] = Q[axis + 3, axis] = density * step_s**2 / 2.0
            Q[axis + 3, axis + 3] = density * step_s
        return replace(self, at_s=at_s, mean=self.mean @ F.T, covariance=F @ self.covariance @ F.T + Q)

    def with_height(self, up_m: float, variance_m2: float) -> PositionSearch:
        """Return the search after a height, whose error lasts: many make it no better known than one."""
        if float(self.covariance[:, 2, 2].min()) <= variance_m2:
            return self
        H = np.zeros((len(self.mean), 1, 6))
        H[:, 0, 2] = 1.0
        innovation = up_m - self.mean[:, 2:3]
        x, P, _, _ = update(self.mean, self.covariance, H, innovation, np.full((len(H), 1), variance_m2))
        return replace(self, mean=x, covariance=P)

    def with_range(self, circle: RangeCircle) -> PositionSearch:
        """Return the search after a range: components too wide are split along its circle, all corrected."""
        use = self.uses.get(circle.peer, 0) + 1
        x, P, w = self._few_wide(circle, use)
        d = x[:, :3] - circle.position_m
        distance = np.maximum(np.linalg.norm(d, axis=1), _LEAST_DISTANCE_M)
        u = d / distance[:, None]
        noise = self._noise(circle, u, P, use)
        wide = _is_wide(P, circle, noise)
        kept = np.flatnonzero(~wide)
        own_m2 = np.einsum("ki,kij,kj->k", u, P[:, :3, :3], u) + noise
        # How much a component remembers of earlier ranges, eq. (39), says nothing of where the vehicle is.
        more_m2 = noise.max() - noise
        parts, fits = [], False
        for i in np.flatnonzero(wide):
            cx, cP, gain, least_nis = self._split(x[i], P[i], circle, use)
            total = log_sum(gain)
            shares = gain - total
            if least_nis > _FALSE_NIS:
                cx, cP, shares = x[i, None], P[i, None], np.zeros(1)
            else:
                fits = True
            parts.append((cx, cP, w[i] + shares + with_more_noise(total, own_m2[i], more_m2[i])))
        if len(kept):
            H = np.zeros((len(kept), 1, 6))
            H[:, 0, :3] = u[kept]
            # Eq. (15).
            across = P[kept, :3, :3].trace(axis1=1, axis2=2) - np.einsum("ki,kij,kj->k", u[kept], P[kept, :3, :3], u[kept])
            longer = 0.5 * across / distance[kept]
            R = noise[kept] + np.minimum(0.5 * (across / distance[kept]) ** 2, noise[kept] + across)
            innovation = (circle.range_m - distance[kept] - longer)[:, None]
            cx, cP, nis, log_det = update(x[kept], P[kept], H, innovation, R[:, None])
            refused = nis > GATE_NIS
            cx = np.where(refused[:, None], x[kept], cx)
            cP = np.where(refused[:, None, None], P[kept], cP)
            fits = fits or not refused.all()
            gain = with_more_noise(-0.5 * (nis + log_det), np.exp(log_det), more_m2[kept])
            parts.append((cx, cP, w[kept] + gain))
        x, P, w = (np.concatenate([part[i] for part in parts]) for i in range(3))
        x, P, w = merged(*pruned(x, P, w))
        refusals = 0 if fits else self.refused + 1
        uses = {**self.uses, circle.peer: use}
        found = replace(self, mean=x, covariance=P, log_weight=w, uses=uses, refused=refusals)
        return replace(found, agreed=self.agreed + 1 if found.place() is not None else 0)

    def _few_wide(self, circle: RangeCircle, use: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the components, merged until few enough are too wide for a range.

        All that are too wide can then be split along its circle. A gap blurs components until they overlap: these are one. What
        is beyond the limit becomes one too.
        """
        x, P, w = self.mean, self.covariance, self.log_weight
        for merge in (merged, tail_merged):
            d = x[:, :3] - circle.position_m
            u = d / np.maximum(np.linalg.norm(d, axis=1), _LEAST_DISTANCE_M)[:, None]
            wide = _is_wide(P, circle, self._noise(circle, u, P, use))
            if int(wide.sum()) <= MOST_SPLIT:
                break
            total = log_sum(w[wide])
            mx, mP, mw = merge(x[wide], P[wide], w[wide])
            mw = mw + total - log_sum(mw)
            x, P, w = (np.concatenate(both) for both in ((x[~wide], mx), (P[~wide], mP), (w[~wide], mw)))
        return x, P, w

    def _noise(self, circle: RangeCircle, u: FloatArray, P: FloatArray, use: int) -> FloatArray:
        """Return the variance (k,) of a range with which the peer's lasting error counts only once.

        So all ranges to the peer together carry their joint information. n ranges of white variance r and a common variance c
        have the information n / (r + n c), eq. (39). Along u a component of variance p > c remembers r / (p - c) earlier ones at
        most: what moved on since counts no longer.
        """
        c, r = np.einsum("ki,ij,kj->k", u, circle.covariance_m2, u), circle.variance_m2
        p = np.einsum("ki,kij,kj->k", u, np.broadcast_to(P[:, :3, :3], (len(u), 3, 3)), u)
        earlier = np.where(p > c, np.minimum(use - 1, r / np.maximum(p - c, _ROUNDING_M2)), use - 1)
        return np.asarray((r + (earlier + 1.0) * c) * (r + earlier * c) / r)

    def _split(
        self, x: FloatArray, P: FloatArray, circle: RangeCircle, use: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return the components of one, split along the circle of a range, eq. (27).

        They are means, covariances, log-likelihoods, and the least NIS of all.
        """
        reach_m = max(circle.range_m, _LEAST_DISTANCE_M)
        sigma_m = math.sqrt(circle.variance_m2 + float(np.trace(circle.covariance_m2)) / 3.0 * use)
        unit, along, spacing_m = range_points(x[:3] - circle.position_m, P[:3, :3], reach_m, math.sqrt(reach_m * sigma_m))
        many, axes = along.shape[:2]
        rows = np.zeros((many, 1 + axes, 6))
        rows[:, 0, :3], rows[:, 1:, :3] = unit, along
        noise_m2 = np.full((many, 1 + axes), spacing_m**2)
        noise_m2[:, 0] = self._noise(circle, unit, P[None], use)
        innovation = np.einsum("kmi,ki->km", rows[:, :, :3], reach_m * unit + circle.position_m - x[:3])
        cx, cP, nis, log_det = update(np.repeat(x[None], many, 0), np.repeat(P[None], many, 0), rows, innovation, noise_m2)
        # The weights of the points are shares of the component's, so their noise along the circle or sphere adds no evidence.
        share = axes * (math.log(spacing_m) - 0.5 * math.log(2.0 * math.pi))
        return cx, cP, share - 0.5 * nis - 0.5 * log_det, float(nis.min())

    def place(self) -> tuple[FloatArray, FloatArray] | None:
        """Return mean (6,) and covariance (6, 6) if all components that matter are at one place.

        None means that several places fit. Components along a short arc are one place; on a long one their mean is a position
        that fits no range.
        """
        weight = np.exp(self.log_weight)
        matter = weight > _LEAST_SHARE * weight.sum()
        x, P, weight = self.mean[matter], self.covariance[matter], weight[matter]
        if len(x) == 1:
            return x[0], 0.5 * (P[0] + P[0].T)
        trace = P[:, :3, :3].trace(axis1=1, axis2=2)
        apart = ((x[:, None, :3] - x[None, :, :3]) ** 2).sum(axis=2)
        linked = apart < _LINKED * (trace[:, None] + trace[None, :])
        here = linked[0]
        for _ in x:
            here, before = linked[here].any(axis=0), here
            if (here == before).all():
                break
        if float(weight[~here].sum()) > _OTHERS_SHARE * float(weight.sum()):
            return None
        mean, covariance = moments(x[here], P[here], weight[here])
        d = x[here, :3] - mean[:3]
        fit = np.einsum("ki,ki->k", d, np.linalg.solve(P[here, :3, :3], d[:, :, None])[:, :, 0])
        return (mean, covariance) if float(fit.min()) < GATE_NIS else None

    def narrow_place(self, distance_m: float, range_sigma_m: float) -> tuple[FloatArray, FloatArray] | None:
        """Return mean (16,) and covariance (16, 16) if there is one narrow place, else None.

        It is narrow if a range of this distance and sigma can be linearised there.
        """
        place = self.place()
        if place is None or self.is_open or sum(self.uses.values()) < _LEAST_RANGES:
            return None
        mean, covariance = place
        spread_m2 = max(float(covariance[0, 0] + covariance[1, 1]), float(covariance[2, 2]))
        if spread_m2 > _NARROW * max(distance_m, _LEAST_DISTANCE_M) * range_sigma_m:
            return None
        P = np.zeros((len(self.other_mean) + 6,) * 2)
        P[:6, :6], P[6:, 6:] = covariance, self.other_covariance
        return np.concatenate([mean, self.other_mean]), P


def _is_wide(P: FloatArray, circle: RangeCircle, noise_m2: FloatArray) -> NDArray[np.bool_]:
    """Return which components (k,) are too wide to linearise a range."""
    spread_m2 = np.maximum(P[:, 0, 0] + P[:, 1, 1], P[:, 2, 2])
    wide: NDArray[np.bool_] = spread_m2 > _SPLIT * max(circle.range_m, _LEAST_DISTANCE_M) * np.sqrt(noise_m2)
    return wide
