"""The explanation of an inconsistency: one fault, several pairs that are off, or more noise.

The inconsistency is one of ranges and reported positions. A fault of receivers is left to the tests over time
(`range_consistency`). Several pairs that are off, or more noise than stated everywhere, may be likelier than such a fault, or
only a device may explain the inconsistency. Then nobody is at fault: the pairs are left out, or the noise is enlarged, and with
it every protection level.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, Past
from gcs_coloc.core.integrity.epoch_tests.fault_tests import FaultTestResult, SignificanceLevels
from gcs_coloc.core.integrity.epoch_tests.isolation import cost_of_two_receivers, isolate
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel, likeliest_noise
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import pair_outliers

_PRESENT: Past = (None, 0.0)


def explain_inconsistency(
    whole: Epoch, result: FaultTestResult | None, noise: NoiseModel, levels: SignificanceLevels, doubtful: Collection[int]
) -> NoiseModel:
    """Return the noise with which an epoch is consistent, or `noise` if that is not clearly likelier.

    `whole` is the epoch with its noise as stated. `result` is that of the epoch's test alone, with `noise`; None where there is
    no redundancy. `doubtful` are the vehicles whose receivers speak against themselves.

    A fault that is nearly as likely is not ruled out, so the tests over time go on. Two receivers that are off, each its own
    way, contradict all others as noise does, and enlarged noise would hide them.
    """
    if result is None or result.is_consistent:
        return noise
    epoch = noise.apply(whole)
    fault = isolate(epoch, _PRESENT, levels, doubtful)
    of_device = noise.with_device_error(fault.device_m) if fault.device_m else None
    if of_device is not None:
        return of_device
    pairs, more = pair_outliers(epoch, levels), likeliest_noise(whole, noise, levels)
    clearly_below = fault.cost - levels.margin
    if pairs is not None and (more is None or pairs.cost <= more.cost) and (pairs.cost < clearly_below or fault.is_of_one_pair):
        return replace(noise, pairs_off=pairs.pairs)
    if more is None or more.cost >= clearly_below:
        return noise
    return more.model if more.cost < cost_of_two_receivers(epoch, _PRESENT, fault.candidates) else noise
