"""A start from ranges beside a faulty device, which is left out.

It alone has to explain why the ranges contradict each other. Huber's loss bounds the pull of a faulty device, but does not end
it: beside few others it draws the place to itself.
"""

from __future__ import annotations

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.fleet.search.range_fit import LEAST_RANGES, RangeFit, RangesToFit, fit_ranges

_OUTLIER_SIGMAS = 5.0  # chosen: less than one Gaussian error in a million
_MOST_OUTLIERS = 0.3  # chosen: with more outliers than three of ten the ranges contradict each other
_MOST_MEAN_SQUARE = 3.0  # chosen: mean squared residual of the ranges that fit, 1 where the sigmas are right
_MOST_MEAN_SQUARE_WITHOUT = 1.5
"""Chosen: the same of those that are left where a device was left out. Of four with two faulty ones half as many starts are wrong
as with 3.0, and of those with one faulty hardly one is missed (tests/unit/estimators/fleet/search/test_faulty_device.py)."""
_PEERS_FOR_EACH_LEFT_OUT = 4  # chosen: two of three fit somewhere whatever they measure, and two faulty ones of five are too many
_MOST_TO_LEAVE_OUT = 8  # chosen: as many as the filter uses at a time; among more one pulls too little to matter
_WHOLE_DEVICE = 0.5  # chosen: with more than half of its ranges outliers a device is faulty, with fewer single ranges are
_CLEARLY_WORSE = 15.0  # chosen: difference of the costs (chi-square) from which on another faulty device is excluded
_TRIED_EFFORT = 0.5  # chosen: what is only compared needs half of the starting points and steps


def fit_without_faulty(to_fit: RangesToFit) -> tuple[RangeFit, frozenset[int]] | None:
    """Return the fit and the peers left out of it; None where the ranges contradict each other."""
    found, left_out = fit_ranges(to_fit), set[int]()
    count = len(set(to_fit.peers.tolist()))
    most = _MOST_MEAN_SQUARE
    while _contradicts(found.residuals(to_fit), most) or (
        count >= _PEERS_FOR_EACH_LEFT_OUT and _faulty_as_a_whole(found.residuals(to_fit), to_fit)
    ):
        may_leave_out = len(left_out) < count // _PEERS_FOR_EACH_LEFT_OUT and count <= _MOST_TO_LEAVE_OUT
        faulty = _faulty_peer(to_fit) if may_leave_out else None
        if faulty is None:
            return None
        left_out.add(faulty)
        to_fit = to_fit.without(faulty)
        found, most = fit_ranges(to_fit), _MOST_MEAN_SQUARE_WITHOUT
    return found, frozenset(left_out)


def _faulty_peer(to_fit: RangesToFit) -> int | None:
    """Return the one peer whose device explains the contradiction; None where that is open.

    Without it the others fit, and its own ranges do not. Where they do fit without any other peer, those that are left contradict
    each other, or fit clearly worse.
    """
    peers = sorted(set(to_fit.peers.tolist()))
    costs, explained, out = [], [], []
    for peer in peers:
        others = to_fit.without(peer)
        found = fit_ranges(others, _TRIED_EFFORT)
        # A range left out costs as much as one that fits does in the mean.
        costs.append(float(found.cost[found.best]) + float(len(to_fit.peers) - len(others.peers)))
        explained.append(len(others.peers) >= LEAST_RANGES and not _contradicts(found.residuals(others), _MOST_MEAN_SQUARE))
        out.append(_faulty_as_a_whole(found.residuals(to_fit), to_fit))
    best = min((i for i in range(len(peers)) if explained[i]), key=lambda i: costs[i], default=None)
    if best is None or peers[best] not in out[best]:
        return None
    # Where the best one is out without another one as well, that is no other explanation.
    rivals = (i for i in range(len(peers)) if peers[best] not in out[i])
    return None if any(explained[i] or costs[i] < costs[best] + _CLEARLY_WORSE for i in rivals) else peers[best]


def _contradicts(residuals: FloatArray, most_mean_square: float) -> bool:
    """Return whether ranges with these residuals (n,), in sigmas, contradict each other.

    They do with too many outliers, or where the mean square of the others is beyond `most_mean_square`.
    """
    fits = np.abs(residuals) <= _OUTLIER_SIGMAS
    return 1.0 - float(fits.mean()) > _MOST_OUTLIERS or float(np.mean(residuals[fits] ** 2)) > most_mean_square


def _faulty_as_a_whole(residuals: FloatArray, of: RangesToFit) -> set[int]:
    """Return the peers most of whose ranges are outliers, by the residuals (n,) in sigmas."""
    outliers = np.abs(residuals) > _OUTLIER_SIGMAS
    return {peer for peer in set(of.peers.tolist()) if float(outliers[of.peers == peer].mean()) > _WHOLE_DEVICE}
