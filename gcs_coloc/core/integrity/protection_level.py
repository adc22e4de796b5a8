"""Protection levels: bounds of the position error, exceeded with the integrity risk only.

They hold whatever single cause acts. The nominal level is K sigma of the estimate. The level of all other hypotheses
(`solution_separation`) is the one that the error exceeds with their share of the integrity risk: each contributes its
separation and its sigma by how often it is true. The protection level is the larger of the two levels, plus what the vehicle
can have moved since its last measurement. A fault that the ranges cannot test (one or two peers, poor geometry) is reported;
the level covers it as if the ranges tested it as coarsely as any that counts.

Source: J. Blanch, T. Walter, P. Enge et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51 (2015); EU-US WG-C, ARAIM
technical subgroup, reference airborne algorithm.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf, log, pi, sqrt

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.integrity.solution_separation import FaultClass, Separation
from gcs_coloc.core.measurements import Estimate, ProtectionLevel
from gcs_coloc.core.setting_bounds import between, check_bounds, positive

_MOST_TESTED_SIGMA_M = 6.0  # chosen: four of them, two for the separation and an unknown delay are within the alert limit
_LASTS_S = 600.0  # chosen: a fault that no test finds lasts for ten minutes
_S_PER_H = 3600.0
VERTICAL_RATIO = 1.6
"""Source: usual VDOP over HDOP of a receiver."""
_NOMINAL_SHARE = 0.5  # of the integrity risk; chosen; the rest is for what may be wrong
_ANGLES_RAD = np.linspace(0.0, pi, 24, endpoint=False)  # chosen: 7.5 degrees apart
_DIRECTIONS = np.column_stack([np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)])
_LEAST_COSINE = 0.01  # chosen: 89 degrees; across it a range shows nothing
_LEVEL_STEP_M = 0.001  # chosen: a level is at most this much too large


@dataclass(frozen=True, slots=True)
class ProtectionSettings:
    """The integrity risk of a protection level, and how often what goes wrong."""

    integrity_risk_per_h: float = between(1e-5, 1e-12, 0.1)
    """How often in an hour under aid the error may exceed the protection level. Chosen: as for an approach with vertical guidance
    (ICAO: 2e-7 in 150 s, 5e-6 in an hour)."""
    independent_s: float = positive(60.0)
    """Errors this far apart in time are independent, s. Source: errors of GNSS positions are correlated for half a minute to
    minutes."""
    receiver_fault_rate_per_h: float = between(1e-4, 1e-12, 1.0)
    """Faults per hour of a receiver that reports none. Chosen: ten times the 1e-5 that GPS commits to for a satellite, for
    spoofing."""
    alike_fault_share: float = between(0.2, 0.0, 1.0)
    """So much rarer is each further receiver at fault at the same time. Chosen: a spoofer reaches several."""
    range_fault_rate_per_h: float = between(1e-4, 1e-12, 1.0)
    """Faults per hour of a pair's or a device's ranges that no test of single ranges refuses. Chosen: as of a receiver."""
    motion_fault_rate_per_h: float = between(1e-3, 1e-12, 1.0)
    """How often per hour a vehicle moves beyond the noise of the model's process. Chosen: ten times as often as faults."""
    common_gnss_sigma_m: float = between(2.0, 0.0, 100.0)
    """1-sigma per axis of the error that all receivers have in common, m; no range shows it. Source: ionosphere and orbits of
    single-frequency receivers, 2 to 4 m (95 %), overbounded."""
    unknown_delay_s: float = between(0.6, 0.0, 5.0)
    """Delay of a link that neither TIMESYNC nor UTC shows, s: times the speed it is a bias. Chosen: a slow mobile network."""
    max_acceleration_mps2: float = positive(9.8)
    """What a vehicle may have done since its last range, position, or attitude with airspeed, m/s². Chosen: 1 g."""

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def nominal_sigmas(self) -> float:
        """K of the nominal level: how many sigmas of the estimate it is."""
        return radius_at_risk(_NOMINAL_SHARE * self.integrity_risk_per_h * self.independent_s / _S_PER_H)

    def rate_per_h(self, hypothesis: Separation) -> float:
        """Return how often per hour a hypothesis becomes true."""
        if hypothesis.fault is FaultClass.RECEIVERS:
            return self.receiver_fault_rate_per_h * self.alike_fault_share ** (len(hypothesis.vehicles) - 1)
        return self.motion_fault_rate_per_h if hypothesis.fault is FaultClass.MOTION else self.range_fault_rate_per_h


@dataclass(frozen=True, slots=True)
class FaultLevel:
    """The level of all hypotheses except the nominal one, by the ranges of one epoch.

    `level_m`: without the bias of unknown delays, m. `estimate_sigma_m`: the estimate's 1-sigma then, m; the level grows with it.
    `ranged_at_s`: service time until which ranges show its motion (`ranged_until_s`). `untested`: as in
    `ProtectionLevel`.
    `other_side_m`: how far off it is on the other side of its peers (`other_side`), which counts unless its motion is shown, m.
    """

    level_m: float
    estimate_sigma_m: float
    ranged_at_s: float
    untested: tuple[int, ...]
    other_side_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Exposure:
    """What the level of one vehicle depends on besides its ranges.

    `delay_is_known`: TIMESYNC, UTC or a setting shows the delay of every link in its position. `shown_until_s`: service time
    until which attitude with airspeed, or its own trusted receiver, shows how it has moved; None where its ranges alone do.
    """

    delay_is_known: bool
    shown_until_s: float | None


def radius_at_risk(probability: float) -> float:
    """Return the radius that a plane Gaussian exceeds with at most this probability, in sigmas.

    The sigma is that of its worst direction. Source: the Rayleigh distribution.
    """
    return sqrt(-2.0 * log(min(probability, 1.0)))


def ranged_until_s(ranges: Sequence[tuple[float, float, float]], now_s: float) -> float:
    """Return until when ranges show the motion of a vehicle in every direction, service time in s.

    `ranges` are the times, s, and the horizontal unit vectors (east, north) of the newest range to each neighbour. A range of
    an age t leaves a t^2 / 2 open along it, and that over the cosine of the angle in another direction. What is returned leaves
    as much open as the range that shows most of it does in the direction that is shown worst.
    """
    lines = np.array(ranges)
    shares = np.maximum(np.abs(_DIRECTIONS @ lines[:, 1:].T), _LEAST_COSINE)
    ages_s2 = np.square(np.maximum(now_s - lines[:, 0], 0.0))
    return now_s - sqrt(float((ages_s2 / shares).min(axis=1).max()))


def is_tested(hypothesis: Separation) -> bool:
    """Return whether ranges test a hypothesis: the position is known without what it holds to be wrong."""
    return hypothesis.sigma_m <= _MOST_TESTED_SIGMA_M


def _is_of_one(hypothesis: Separation, vehicle: int) -> bool:
    """Return whether a hypothesis is the fault of one receiver, or of the vehicle's own ranging device."""
    of_receiver = hypothesis.fault is FaultClass.RECEIVERS and len(hypothesis.vehicles) == 1
    return of_receiver or (hypothesis.fault is FaultClass.RANGES and hypothesis.vehicles == (vehicle,))


def fault_level(
    hypotheses: Sequence[Separation],
    estimate: Estimate,
    ranged_at_s: float,
    settings: ProtectionSettings,
    also: Mapping[frozenset[int], float] | None = None,
    unisolated: Collection[tuple[int, ...]] = (),
) -> FaultLevel:
    """Return the level of all hypotheses, as far as the ranges test them.

    `also`: a fault was found and not isolated; these receivers, which are in use, may be off as well or instead, with the
    probability of it at most. `unisolated`: the ranges of one of these pairs or devices are off, and it is open which.
    """
    untested = {each.vehicles[0] for each in hypotheses if _is_of_one(each, estimate.vehicle) and not is_tested(each)}
    level_m = _level_m(hypotheses, settings, also, unisolated)
    return FaultLevel(level_m, horizontal_sigma_m(estimate.protected_covariance), ranged_at_s, tuple(sorted(untested)))


def _level_m(
    hypotheses: Sequence[Separation],
    settings: ProtectionSettings,
    also: Mapping[frozenset[int], float] | None,
    unisolated: Collection[tuple[int, ...]],
) -> float:
    """Return the level that the error exceeds with the risk of all hypotheses together, in m.

    It is the L with sum of p exp(-((L - separation) / sigma)^2 / 2) = risk. p is the number of independent errors in an hour
    under a hypothesis.

    Source: the HPL equation of the reference algorithm, with the Rayleigh distribution as the Gaussian's tail. A hypothesis
    whose separation is beyond the level counts in full. One whose solution is coarser than the most that is tested is scaled to
    that, its separation with it: a level neither falls as a test becomes worse, nor grows without end where there is none.
    Beside a fault that is there nothing is assumed away: with `also` all count as they are, and so do the unisolated.
    """
    risk = (1.0 - _NOMINAL_SHARE) * settings.integrity_risk_per_h
    exposed = max(_LASTS_S / settings.independent_s, 1.0)
    p = np.array([settings.rate_per_h(each) * exposed for each in hypotheses])
    if also is not None:
        odds = [also.get(frozenset(h.vehicles), 0.0) if h.fault is FaultClass.RECEIVERS else 0.0 for h in hypotheses]
        p = np.maximum(p, odds)
    is_unisolated = np.array([each.fault is FaultClass.RANGES and each.vehicles in unisolated for each in hypotheses])
    p = np.where(is_unisolated, 1.0, p)
    if p.sum() <= risk:
        return 0.0
    solution_sigmas_m = np.array([each.sigma_m for each in hypotheses])
    most_m = np.where(is_unisolated | (also is not None), inf, _MOST_TESTED_SIGMA_M)
    share = np.minimum(most_m / np.maximum(solution_sigmas_m, 1e-9), 1.0)
    separations_m = share * np.array([each.separation_m for each in hypotheses])
    sigmas_m = np.hypot(share * solution_sigmas_m, settings.common_gnss_sigma_m)
    # No less than the level of each alone, no more than if each were as likely as all together.
    alone = np.sqrt(2.0 * np.log(np.maximum(p / risk, 1.0)))
    low_m = float((separations_m + sigmas_m * alone)[p > risk].max(initial=0.0))
    high_m = float((separations_m + sigmas_m * radius_at_risk(risk / float(p.sum()))).max())
    while high_m - low_m > _LEVEL_STEP_M:
        level_m = 0.5 * (low_m + high_m)
        beyond = np.maximum(level_m - separations_m, 0.0) / sigmas_m
        if float(p @ np.exp(-0.5 * beyond * beyond)) > risk:
            low_m = level_m
        else:
            high_m = level_m
    return high_m


def protection_level(
    estimate: Estimate, faults: FaultLevel | None, exposure: Exposure, settings: ProtectionSettings
) -> ProtectionLevel:
    """Return HPL and VPL of an estimate; `faults` is None for a vehicle whose own receiver is in it.

    What the vehicle can have done since its motion was last shown is in both.
    """
    common_m = settings.common_gnss_sigma_m
    sigma_m, sigma_v_m = horizontal_sigma_m(estimate.protected_covariance), sqrt(float(estimate.covariance[2, 2]))
    horizontal_m = settings.nominal_sigmas * hypot(sigma_m, common_m)
    vertical_m = settings.nominal_sigmas * hypot(sigma_v_m, VERTICAL_RATIO * common_m)
    untested: tuple[int, ...] = ()
    shown_until_s = exposure.shown_until_s
    if faults is not None:
        grown_m = settings.nominal_sigmas * max(sigma_m - faults.estimate_sigma_m, 0.0)
        horizontal_m = max(horizontal_m, faults.level_m + grown_m)
        if shown_until_s is None:
            horizontal_m = max(horizontal_m, faults.other_side_m)
        untested = faults.untested
        shown_until_s = max(faults.ranged_at_s, shown_until_s) if shown_until_s is not None else faults.ranged_at_s
    if shown_until_s is not None:
        moved_m = 0.5 * settings.max_acceleration_mps2 * max(estimate.at_s - shown_until_s, 0.0) ** 2
        horizontal_m, vertical_m = horizontal_m + moved_m, vertical_m + moved_m
    if not exposure.delay_is_known:
        east_mps, north_mps, up_mps = estimate.velocity_enu_mps.tolist()
        horizontal_m += settings.unknown_delay_s * hypot(east_mps, north_mps)
        vertical_m += settings.unknown_delay_s * abs(up_mps)
    return ProtectionLevel(horizontal_m, vertical_m, untested)
