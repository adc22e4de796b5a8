"""Evidence over time that receivers are worse than they state, while no test of one epoch fails.

Receivers that state half of their error make the ranges fit badly all the time, and hardly ever badly enough for a test that may
not raise a false alarm in a year. Sooner or later the one that is off most looks like a fault. So the odds that all positions are
worse than stated are carried from epoch to epoch. Errors of positions last, so epochs within their correlation time share its
evidence. A receiver that is drawn off meets odds that its past has made small.

Source: A. Wald, Sequential Analysis (1947), chapter 3, the likelihood ratio of two hypotheses as samples arrive.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, log

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch
from gcs_coloc.core.integrity.epoch_tests.fault_tests import SignificanceLevels
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel, restricted_likelihood
from gcs_coloc.core.schedule import SAME_S

_EVERY_S = 5.0  # chosen: bounds the cost, up to seventeen likelihoods; positions err for longer
_FIRST_LOG_ODDS = -2.0 * log(100.0)
"""Chosen: the receivers of one fleet in a hundred state half of their error."""
_LEAST_LOG_ODDS = 2.0 * _FIRST_LOG_ODDS
"""Chosen: what a long sound flight shows is not held against a receiver whose sky is shaded later."""


@dataclass(slots=True)
class AccuracyEvidence:
    """The odds that positions err twice as much as the noise in force says.

    `log_odds` is twice their logarithm. `due_s` is when the next epoch counts.
    """

    log_odds: float = _FIRST_LOG_ODDS
    due_s: float = -inf

    def update(self, epoch: Epoch, noise: NoiseModel, levels: SignificanceLevels, correlation_time_s: float) -> NoiseModel:
        """Add an epoch as stated, if it is due; return the noise, with coarser positions if likelier.

        Positions become coarser only where that is clearly likelier. Where something else explains the epoch better, it is no
        evidence for coarser positions.
        """
        if epoch.at_s < self.due_s or not epoch.residuals:
            return noise
        self.due_s = epoch.at_s + _EVERY_S - SAME_S
        coarser = noise.with_coarser_positions()
        if coarser is None:
            return noise
        cost = restricted_likelihood(coarser.apply(epoch)).cost
        gain = restricted_likelihood(noise.apply(epoch)).cost - cost
        others = (model for model in noise.larger() if model.position_factor == noise.position_factor)
        if gain <= 0.0 or all(cost <= restricted_likelihood(model.apply(epoch)).cost for model in others):
            self.log_odds = max(self.log_odds + gain * _EVERY_S / correlation_time_s, _LEAST_LOG_ODDS)
        if self.log_odds <= levels.margin:
            return noise
        self.log_odds = _FIRST_LOG_ODDS
        return coarser
