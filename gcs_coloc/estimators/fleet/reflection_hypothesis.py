"""Reflection hypothesis: a model in which some denied vehicles are reflected, and its odds.

The odds are those against the main model, eq. (24).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from gcs_coloc.estimators.fleet.ambiguity.reflection import CLEARLY_ASIDE_SIGMAS, ReflectionPlane, offset_sigmas
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.fleet_model import FleetModel

_MOST_NIS = 20.0  # chosen: bounds the evidence of one measurement: an outlier of both models says little
_MERGED_NIS = 0.5  # chosen: hypotheses closer than 0.7 sigma of six components are merged
_MANOEUVRE_S = 3.0  # chosen: an unmodelled manoeuvre is in all innovations of so long; they are one piece of evidence
_MOST_OF_MOTION = 3.0  # chosen: bounds the log odds that one such manoeuvre contributes


class RelativeSide(Enum):
    """On which sides of the reflection plane a vehicle is in the main model and in its hypothesis."""

    APART = auto()
    """On opposite sides."""
    SAME = auto()
    """Both on one side."""
    OPEN = auto()
    """At least one of them too near to the plane."""


@dataclass(slots=True)
class ReflectionHypothesis:
    """A model in which denied vehicles are reflected, with its odds against the main model.

    `log_odds` is the logarithm of the odds. `motion_only`: only the process model separates the two. `peers_may_move`: that may
    as well be the motion of a denied peer. `separated`: in the last test one of them was on opposite sides.
    """

    model: FleetModel
    motion_only: bool
    peers_may_move: bool = False
    log_odds: float = 0.0
    separated: bool = True
    _since_s: float = -math.inf
    _before: float = 0.0
    _raised: float = 0.0

    def add_evidence(self, gain: float, at_s: float) -> None:
        """Add a log-likelihood ratio, eq. (24).

        Its sum over a manoeuvre is bounded if motion alone tells; it is nothing if a denied peer may have moved instead.
        """
        if self.motion_only and self.peers_may_move:
            return
        if not self.motion_only:
            self.log_odds += gain
            self._since_s = -math.inf
            return
        if at_s - self._since_s > _MANOEUVRE_S:
            self._since_s, self._before, self._raised = at_s, self.log_odds, 0.0
        self._raised += gain
        self.log_odds = self._before + min(max(self._raised, -_MOST_OF_MOTION), _MOST_OF_MOTION)

    def reset_odds(self) -> None:
        """Set even odds."""
        self.log_odds, self._since_s = 0.0, -math.inf

    def compare_with(self, other: ReflectionHypothesis) -> None:
        """Change the odds, against the main model so far, to those against another hypothesis."""
        if self.motion_only or other.motion_only:
            # Bounded evidence says how the motion was, and not by how much one of the two fits better.
            self.reset_odds()
        else:
            self.log_odds -= other.log_odds


def relative_side(
    cluster: Cluster, other: Cluster, denied_vehicle: int, plane: ReflectionPlane | None, at_s: float
) -> RelativeSide:
    """Return on which sides of a plane a vehicle is in two models: apart where its peers are in no plane."""
    if plane is None:
        return RelativeSide.APART
    away, other_away = (offset_sigmas(one, denied_vehicle, plane, at_s) for one in (cluster, other))
    if min(abs(away), abs(other_away)) < CLEARLY_ASIDE_SIGMAS:
        return RelativeSide.OPEN
    return RelativeSide.SAME if away * other_away > 0.0 else RelativeSide.APART


def is_merged(cluster: Cluster, other: Cluster, denied_vehicle: int, at_s: float) -> bool:
    """Return whether a vehicle's states in two models are too close to tell them apart."""
    x, P = cluster.predict(denied_vehicle, at_s)
    other_x, other_P = other.predict(denied_vehicle, at_s)
    d, S = (other_x - x)[:6], (P + other_P)[:6, :6]
    return float(d @ np.linalg.solve(S, d)) < _MERGED_NIS


def log_likelihood_ratio(main: UpdateResult, hypothesis: UpdateResult, *, may_climb: bool) -> float:
    """Return the log-likelihood ratio of a measurement, hypothesis against main model, eq. (24).

    Where only motion separates them, and a vehicle that turns in one of them climbs in the other (`may_climb`), both have the
    larger sigma of the range: that it moves little is no evidence for the side on which it could have moved less.
    """
    if main.degrees_of_freedom == 0 or hypothesis.degrees_of_freedom == 0:
        return 0.0
    nis, other_nis, gain = main.nis, hypothesis.nis, 0.0
    if main.sigma_m > 0.0 and hypothesis.sigma_m > 0.0:
        ratio = main.sigma_m / hypothesis.sigma_m
        if may_climb:
            nis, other_nis = nis * min(ratio, 1.0) ** 2, other_nis / max(ratio, 1.0) ** 2
        else:
            gain = math.log(ratio)
    return gain + 0.5 * (min(nis, _MOST_NIS) - min(other_nis, _MOST_NIS))
