"""Evidence on the noise, from one inconsistent epoch and over time where no single epoch fails.

An inconsistency of ranges and reported positions is one fault, several pairs that are off, or more noise. A fault of receivers is
left to the tests over time (`range_consistency`). Several pairs that are off, or more noise than stated everywhere, may be
likelier than such a fault, or only a device may explain the inconsistency. Then nobody is at fault: the pairs are left out, or
the noise is enlarged, and with it every protection level.

Receivers that state half of their error make the ranges fit badly all the time, and hardly ever badly enough for a test that may
not raise a false alarm in a year. Sooner or later the one that is off most looks like a fault. So the odds that all positions are
worse than stated are carried from epoch to epoch. Errors of positions last, so epochs within their correlation time share its
evidence. A receiver that is drawn off meets odds that its past has made small.

Source: A. Wald, Sequential Analysis (1947), chapter 3, the likelihood ratio of two hypotheses as samples arrive.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from math import inf, log

from gcs_coloc.core.integrity.epoch_tests.epoch import CORRELATION_TIME_S, Epoch, Past
from gcs_coloc.core.integrity.epoch_tests.fault_tests import RULED_OUT_MARGIN, FaultTestResult
from gcs_coloc.core.integrity.epoch_tests.isolation import cost_of_two_receivers, isolate
from gcs_coloc.core.integrity.epoch_tests.noise_model import (
    NoiseModel,
    clearly_smaller_noise,
    likeliest_noise,
    restricted_likelihood,
)
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import Pair, pair_outliers
from gcs_coloc.core.schedule import SAME_S

_PRESENT: Past = (None, 0.0)
_SMALLER_EVERY_S = 1.0  # chosen: one window of ranges
_SMALLER_WINDOWS = 10
"""Windows in a row in which a smaller noise is clearly likelier before it counts. Chosen: lasting errors show in each of them."""
_EVERY_S = 5.0  # chosen: bounds the cost, up to seventeen likelihoods; positions err for longer
_FIRST_LOG_ODDS = -2.0 * log(100.0)  # chosen: the receivers of one fleet in a hundred state half of their error
_LEAST_LOG_ODDS = 2.0 * _FIRST_LOG_ODDS
"""Chosen: what a long sound flight shows is not held against a receiver whose sky is shaded later."""


def explain_inconsistency(
    whole: Epoch, result: FaultTestResult | None, noise: NoiseModel, doubtful: Collection[int], known: Collection[Pair] = ()
) -> NoiseModel:
    """Return the noise with which an epoch is consistent, or `noise` if that is not clearly likelier.

    `whole` is the epoch with its noise as stated. `result` is that of the epoch's test alone, with `noise`; None where there is
    no redundancy. `doubtful` are the vehicles whose receivers speak against themselves, `known` the pairs that were isolated just
    before.

    A fault that is nearly as likely is not ruled out, so the tests over time go on. Two receivers that are off, each its own
    way, contradict all others as noise does, and enlarged noise would hide them.
    """
    if result is None or result.is_consistent:
        return noise
    epoch = noise.apply(whole)
    fault = isolate(epoch, _PRESENT, doubtful)
    of_device = noise.with_device_error(fault.device_m) if fault.device_m else None
    if of_device is not None:
        return of_device
    pairs, more = pair_outliers(epoch, known), likeliest_noise(whole, noise)
    clearly_below = fault.cost - RULED_OUT_MARGIN
    if pairs is not None and (more is None or pairs.cost <= more.cost) and (pairs.cost < clearly_below or fault.is_of_one_pair):
        return replace(noise, pairs_off=pairs.pairs, unisolated=pairs.unisolated)
    is_clear = more is not None and more.cost < clearly_below
    if more is not None and is_clear and more.cost < cost_of_two_receivers(epoch, _PRESENT, fault.candidates):
        return more.model
    return replace(noise, unisolated=frozenset(each.vehicles for each in fault.plausible)) if fault.is_range_fault else noise


@dataclass(slots=True)
class SmallerNoise:
    """How many windows in a row were clearly likelier with less noise than that in force."""

    windows: int = 0
    due_s: float = -inf

    def update(self, epoch: Epoch, noise: NoiseModel, now_s: float) -> NoiseModel | None:
        """Add an epoch as stated, if it is due; return the smaller noise once it has long been likelier."""
        if noise.is_as_stated:
            self.windows = 0
        elif epoch.residuals and now_s >= self.due_s:
            self.due_s = now_s + _SMALLER_EVERY_S - SAME_S
            smaller = clearly_smaller_noise(epoch, noise)
            self.windows = self.windows + 1 if smaller is not None else 0
            if self.windows >= _SMALLER_WINDOWS:
                self.windows = 0
                return smaller
        return None


@dataclass(slots=True)
class AccuracyEvidence:
    """The odds that positions err twice as much as the noise in force says.

    `log_odds` is twice their logarithm. `due_s` is when the next epoch counts.
    """

    log_odds: float = _FIRST_LOG_ODDS
    due_s: float = -inf

    def update(self, epoch: Epoch, noise: NoiseModel) -> NoiseModel:
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
            self.log_odds = max(self.log_odds + gain * _EVERY_S / CORRELATION_TIME_S, _LEAST_LOG_ODDS)
        if self.log_odds <= RULED_OUT_MARGIN:
            return noise
        self.log_odds = _FIRST_LOG_ODDS
        return coarser
