"""Evidence over time that receivers are worse than they state, while no test of one epoch fails.

Receivers that state half of their error make the ranges fit badly all the time, and hardly ever badly enough for a test that may
not raise a false alarm in a year. Sooner or later the one that is off most looks like a fault. So the odds that all positions are
worse than stated are carried from epoch to epoch. Errors of positions last, so epochs within their correlation time share its
evidence. A receiver that is drawn off meets odds that its past has made small.

Source: A. Wald, Sequential Analysis (1947), chapter 3, the likelihood ratio of two hypotheses as samples arrive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, log

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch
from gcs_coloc.core.integrity.epoch_tests.fault_tests import SignificanceLevels
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel, restricted_likelihood
from gcs_coloc.core.schedule import SAME_S

_EVERY_S = 5.0  # chosen: bounds the cost, fifteen likelihoods; positions err for longer
_FIRST_LOG_ODDS = -2.0 * log(100.0)
"""Chosen: the receivers of one fleet in a hundred state half of their error."""
_LEAST_LOG_ODDS = 2.0 * _FIRST_LOG_ODDS
"""Chosen: what a long sound flight shows is not held against a receiver whose sky is shaded later."""


@dataclass(slots=True)
class AccuracyEvidence:
    """Twice the log of the odds that positions are worse than `noise_model` has them, and when the next epoch counts."""

    log_odds: float = _FIRST_LOG_ODDS
    due_s: float = -inf

    def update(self, epoch: Epoch, noise: NoiseModel, levels: SignificanceLevels, correlation_time_s: float) -> NoiseModel:
        """Add an epoch as stated, if it is due. Return the noise, with less accurate positions where these are clearly likelier.

        Where something else explains the epoch better, it is no evidence for less accurate positions.
        """
        if epoch.at_s < self.due_s or not epoch.residuals:
            return noise
        self.due_s = epoch.at_s + _EVERY_S - SAME_S
        present = restricted_likelihood(noise.apply(epoch)).cost
        gains = {model: present - restricted_likelihood(model.apply(epoch)).cost for model in noise.larger()}
        worse = next((model for model in gains if model.position_factor > noise.position_factor), None)
        if worse is None:
            return noise
        gain = gains[worse]
        others = max(each for model, each in gains.items() if model.position_factor == noise.position_factor)
        if gain <= 0.0 or gain >= others:
            self.log_odds = max(self.log_odds + gain * _EVERY_S / correlation_time_s, _LEAST_LOG_ODDS)
        if self.log_odds <= levels.margin:
            return noise
        self.log_odds = _FIRST_LOG_ODDS
        return replace(noise, position_factor=worse.position_factor)
