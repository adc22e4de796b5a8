"""The forecast of a loss of GPS: would a fix from ranges still be stated, and how good is it?

The estimator's prediction gets its protection level and is put to the fix policy, as in flight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.aiding.fix_policy import FixPolicy
from gcs_coloc.core.aiding.inhibit import Inhibit
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, height_sigma_m
from gcs_coloc.core.integrity.fault_monitor import expected_separation_m2
from gcs_coloc.core.integrity.protection_level import Exposure, FaultLevel, ProtectionSettings, fault_level, protection_level
from gcs_coloc.core.integrity.report import IntegrityReport
from gcs_coloc.core.integrity.solution_separation import SolutionSeparation, noise_excess_m2
from gcs_coloc.core.measurements import Estimate, NoEstimate, PositionMeasurement, Vector3
from gcs_coloc.core.readiness.held_motion import HeldMotion
from gcs_coloc.core.readiness.vehicle_readiness import (
    IN_LINE_HDOP,
    Limit,
    LimitingReason,
    ReadinessState,
    VehicleReadiness,
    limiting_reason,
)
from gcs_coloc.core.stations.node_id import node_names, untested_text

_MOST_HDOP_CHANGE, _MOST_INFLATION, _MOST_BOUND_CHANGE = 1.3, 1.25, 1.15
_LEAST_RANGES_HZ = 5.0
"""Chosen on 143 losses of 15 kinds, of which 40 % are told so. With a smaller change of the HDOP nothing is gained, and with a
larger one turns to come make the bound another. With fewer ranges a second it is what the vehicle does between them that counts.
Flights that it was not chosen on: docs/results/readiness.md."""


class EarlierPrediction(NamedTuple):
    """What an earlier prediction told: the HDOP then, and the 95 % bound at its horizon, m."""

    hdop: float
    bound_m: float


@dataclass(frozen=True, slots=True)
class LossSituation:
    """A vehicle, and what would place it without GPS.

    `peers` are the reported positions of the nodes that it ranges; `epoch` the residuals of its ranges now, with zero values, and
    `stated_epoch` the same with their noise as stated. `velocity_enu_mps` is that of the vehicle, `turns_radps` the turn rates
    that are held. `interval_s` is the mean time between its ranges, `ranges_hz` how many there are in a second. `recent` are the
    predictions of the last minute; empty where it was not followed for so long.
    """

    vehicle: int
    velocity_enu_mps: Vector3
    peers: Mapping[int, PositionMeasurement]
    epoch: Epoch
    stated_epoch: Epoch
    turns_radps: Mapping[int, float]
    interval_s: float
    ranges_hz: float
    exposure: Exposure
    recent: Sequence[EarlierPrediction] = ()


def forecast(
    situation: LossSituation, answers: Sequence[Estimate | NoEstimate], aiding: AidingSettings, protection: ProtectionSettings
) -> VehicleReadiness:
    """Return the readiness of a vehicle by its predictions from the loss up to the horizon, in order."""
    begin_s = answers[0].at_s
    policy = FixPolicy(aiding, begin_s)
    # At the loss itself no range has been used yet.
    hdop_now, hdop = _hdop(answers[min(1, len(answers) - 1)]), _hdop(answers[-1])
    # What holds at the horizon counts from half of the way on.
    half_s, integrity = 0.5 * (begin_s + answers[-1].at_s), _expected_report(situation, answers[-1], begin_s)
    as_filtered_m = _bound_m(answers[-1])
    answers = [integrity.inflate(a) if isinstance(a, Estimate) and a.at_s >= half_s > begin_s else a for a in answers]
    levels = _fault_level(situation, answers[0], begin_s, protection), _fault_level(situation, answers[-1], begin_s, protection)
    stated: list[Estimate | NoEstimate] = []
    inhibits: list[Inhibit | None] = []
    for answer in answers:
        stated.append(_protected(answer, levels[answer.at_s >= half_s], situation, protection))
        air_data = situation.exposure.shown_until_s is not None
        inhibits.append(policy.inhibit(stated[-1], answer.at_s, own_gps=False, air_data=air_data))
    state, limit = _judge(situation, inhibits, stated, max(hdop_now or 0.0, hdop or 0.0))
    now, later = stated[0], stated[-1]
    return VehicleReadiness(
        state,
        begin_s,
        limit.reason.code if limit is not None else None,
        limit.text if limit is not None else "",
        len(situation.peers),
        _bound_m(now),
        _bound_m(later),
        _hpl_m(now),
        _hpl_m(later),
        hdop_now,
        hdop,
        _is_told(situation, answers, as_filtered_m),
    )


def _judge(
    situation: LossSituation, inhibits: Sequence[Inhibit | None], stated: Sequence[Estimate | NoEstimate], hdop: float
) -> tuple[ReadinessState, Limit | None]:
    nodes, last = tuple(situation.peers), stated[-1]
    # What is so at the end counts before what was so on the way.
    at = next((k for k in (-1, *range(len(inhibits))) if inhibits[k] is not None), -1)
    limit = limiting_reason(inhibits[at], stated[at], hdop, nodes)
    if inhibits[-1] is not None:
        return ReadinessState.NOT_READY, limit
    if limit is None and len(nodes) == 1:
        limit = Limit(LimitingReason.ONE_PEER, detail=node_names(nodes))
    if limit is None and hdop >= IN_LINE_HDOP:
        limit = Limit(LimitingReason.IN_LINE, min(hdop, 999.0), detail=node_names(nodes))
    untested = last.protection.untested if isinstance(last, Estimate) and last.protection is not None else ()
    if limit is None and untested:
        limit = Limit(LimitingReason.NOT_TESTED, detail=untested_text(untested, situation.vehicle))
    return (ReadinessState.READY if limit is None else ReadinessState.DEGRADED), limit


def _protected(
    answer: Estimate | NoEstimate, faults: FaultLevel | None, situation: LossSituation, settings: ProtectionSettings
) -> Estimate | NoEstimate:
    if isinstance(answer, NoEstimate):
        return answer
    if faults is not None:
        faults = replace(faults, ranged_at_s=answer.at_s - situation.interval_s)
    return replace(answer, protection=protection_level(answer, faults, situation.exposure, settings))


def _fault_level(
    situation: LossSituation, answer: Estimate | NoEstimate, begin_s: float, settings: ProtectionSettings
) -> FaultLevel | None:
    """Return the fault level at the time of an answer; None without an estimate or a range.

    The ranges are adjusted under all fault hypotheses, with the vehicle and its peers where they are then.
    """
    if not isinstance(answer, Estimate) or not situation.epoch.residuals:
        return None
    separation = SolutionSeparation(_at(situation, situation.epoch, answer, begin_s))
    return fault_level(separation.of(situation.vehicle), answer, answer.at_s, settings)


def _expected_report(situation: LossSituation, answer: Estimate | NoEstimate, begin_s: float) -> IntegrityReport:
    """Return the integrity report that is expected at the time of an answer.

    It has the inflation of the covariance, for noise beyond the stated one and for possible faults.
    """
    if not isinstance(answer, Estimate) or not situation.epoch.residuals:
        return IntegrityReport()
    vehicle, as_stated = situation.vehicle, _at(situation, situation.stated_epoch, answer, begin_s)
    is_as_stated = situation.epoch is situation.stated_epoch
    as_found = as_stated if is_as_stated else _at(situation, situation.epoch, answer, begin_s)
    parts_m2 = expected_separation_m2(as_stated, vehicle), noise_excess_m2(as_stated, as_found).get(vehicle)
    known_m2 = [part_m2 for part_m2 in parts_m2 if part_m2 is not None]
    return IntegrityReport(separation_m2={vehicle: np.sum(known_m2, axis=0)} if known_m2 else {})


def _at(situation: LossSituation, epoch: Epoch, answer: Estimate, begin_s: float) -> Epoch:
    """Return an epoch where the vehicle and its peers are at the time of an answer."""
    span_s, vehicle = answer.at_s - begin_s, situation.vehicle
    priors = {
        node: prior._replace(position_enu_m=_moved(situation, node, prior.position_enu_m, span_s))
        for node, prior in epoch.priors.items()
        if node != vehicle
    }
    e, n, u = answer.position_enu_m.tolist()
    sigma_v_m = height_sigma_m(answer.covariance)
    priors[vehicle] = PositionPrior((e, n, u), 0.0, sigma_v_m, no_prior=True)
    return replace(epoch, priors=priors)


def _moved(situation: LossSituation, node: int, place: Vector3, span_s: float) -> Vector3:
    """Return where a node is later if it holds its motion."""
    velocity, turns = situation.peers[node].velocity_enu_mps or (0.0, 0.0, 0.0), situation.turns_radps
    own = HeldMotion(place, situation.velocity_enu_mps, turns.get(situation.vehicle, 0.0))
    return HeldMotion(place, velocity, turns.get(node, 0.0)).in_formation_with(own).after(span_s).position


def _is_told(situation: LossSituation, answers: Sequence[Estimate | NoEstimate], as_filtered_m: float | None) -> bool:
    """Return whether the forecast states how large the later bound is.

    It does where the geometry hardly changes on the way, and hardly did in the last minute, whose forecasts told about the same.
    Otherwise the bound depends on turns to come, which nobody knows. With peers in one line, noise decides, and the filter
    remembers that noise for a while. With one node the same is true along the circle around it. What integrity adds to
    `as_filtered_m` depends on what its tests find next. With few ranges the vehicle's manoeuvres count, whose level the filter
    learns only once it locates it.
    """
    recent, bound_m, ahead = situation.recent, _bound_m(answers[-1]), [_hdop(answer) for answer in answers[1:]]
    if (
        situation.ranges_hz < _LEAST_RANGES_HZ
        or not recent
        or bound_m is None
        or as_filtered_m is None
        or bound_m > _MOST_INFLATION * as_filtered_m
    ):
        return False
    usual_m = median([*(earlier.bound_m for earlier in recent), bound_m])
    if max(bound_m, usual_m) > _MOST_BOUND_CHANGE * min(bound_m, usual_m):
        return False
    known = [*(earlier.hdop for earlier in recent), *(hdop for hdop in ahead if hdop is not None)]
    return len(known) == len(recent) + len(ahead) and max(known) < min(IN_LINE_HDOP, _MOST_HDOP_CHANGE * min(known))


def _hdop(answer: Estimate | NoEstimate) -> float | None:
    return answer.hdop if isinstance(answer, Estimate) else None


def _bound_m(answer: Estimate | NoEstimate) -> float | None:
    return horizontal_bound_95_m(answer.covariance) if isinstance(answer, Estimate) else None


def _hpl_m(answer: Estimate | NoEstimate) -> float | None:
    return answer.protection.horizontal_m if isinstance(answer, Estimate) and answer.protection is not None else None
