"""The report of the integrity stage, and what a review takes of each vehicle. Every value is frozen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from gcs_coloc.core.gps_health.evidence import PositionFault
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.protection_level import FaultLevel
from gcs_coloc.core.measurements import Estimate, FloatArray, PositionMeasurement

SEPARATION_GROWTH_TIME_S = 5.0
"""A displacement that grew within this time is in the velocity as well. Chosen: longer trusts the velocity sooner."""


@dataclass(frozen=True, slots=True)
class ReviewedVehicle:
    """One vehicle, or station, as a review sees it. `sysid` is its node id.

    A station reports where it is and has no receiver: it is a witness until it is identified as standing elsewhere.

    `gps_state` and `is_trusted` (its reported position is evidence) are results of the round before. `is_witness`: nothing bad is
    known of it, so that its position is tested against the others'. `is_automatic`: no operator override of its GPS is in force.
    `is_returning`: it has failed, and its receiver has a good fix again. `is_doubtful`: its receiver's fixes do not move as
    its own velocity says, which counts where ranges leave open who is at fault.
    `reported` is the newest position that its autopilot reports, `receiver_fix` that of its own receiver while the reported one
    is not evidence. `estimate` is the estimator's answer now, of a distrusted vehicle that is no witness. `median_nis` is the
    median normalised innovation squared of its recent ranges, `range_jump_m` the common jump of all its ranges; None where there
    is none.
    """

    sysid: int
    gps_state: GpsState
    is_trusted: bool
    is_witness: bool
    is_automatic: bool
    is_returning: bool = False
    is_doubtful: bool = False
    reported: PositionMeasurement | None = None
    receiver_fix: PositionMeasurement | None = None
    estimate: Estimate | None = None
    median_nis: float | None = None
    range_jump_m: float | None = None


class ReacquisitionStatus(Enum):
    """What the checks of a receiver that is back have found so far."""

    PENDING = "too early to tell"
    UNTESTED = "nothing to test it against"
    CONSISTENT = "consistent with ranges and estimate"
    CONTRADICTED = "contradicted just now"


@dataclass(frozen=True, slots=True)
class IntegrityReport:
    """The result of one review.

    `faults`: the vehicles with a fault, identified or only detected. `separation_m2`: for each located vehicle the second moment
    (2, 2) of how far possible faults may have moved it, east and north, in m^2. `fault_levels`: of each vehicle that ranges
    place, what its error does not exceed under the hypotheses that they test. `untested`: the vehicles that ranges alone
    place, or are about to, and whose ranges are still to be tested. `reacquisitions`: the receivers that are back.
    `diverged`: the vehicles whose estimate is wrong, so that the estimator must initialise them again. `rejected_fixes`: how many
    receivers were back and found wrong, since the start. `noise`: how much worse ranges and positions are than they state;
    `range_excess_m2`: the variance that this gives the residuals of each pair, none where all is as stated.
    """

    faults: Mapping[int, PositionFault] = field(default_factory=dict)
    separation_m2: Mapping[int, FloatArray] = field(default_factory=dict)
    fault_levels: Mapping[int, FaultLevel] = field(default_factory=dict)
    untested: frozenset[int] = frozenset()
    reacquisitions: Mapping[int, ReacquisitionStatus] = field(default_factory=dict)
    diverged: frozenset[int] = frozenset()
    rejected_fixes: int = 0
    noise: NoiseModel = field(default_factory=NoiseModel)
    range_excess_m2: Mapping[tuple[int, int], float] = field(default_factory=dict)

    def inflate(self, estimate: Estimate) -> Estimate:
        """Return the estimate with the solution separation of its vehicle added to its covariance."""
        separation_m2 = self.separation_m2.get(estimate.vehicle)
        if separation_m2 is None or not separation_m2.any():
            return estimate
        covariance = estimate.covariance.copy()
        covariance[:2, :2] += separation_m2
        covariance[3:5, 3:5] += separation_m2 / SEPARATION_GROWTH_TIME_S**2
        # Twice as fast as dataclasses.replace.
        return Estimate(
            estimate.vehicle,
            estimate.at_s,
            estimate.position_enu_m,
            estimate.velocity_enu_mps,
            covariance,
            estimate.hdop,
            estimate.ranges_in_use,
            far_covariance=None if estimate.far_covariance is None else estimate.far_covariance + separation_m2,
            refuses_air_data=estimate.refuses_air_data,
            air_data_at_s=estimate.air_data_at_s,
        )
