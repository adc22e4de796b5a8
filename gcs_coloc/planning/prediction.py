"""Prediction: the fleet filter along planned ways, with measurements without noise.

The measurements are those of the true positions. Filter, hypotheses, protection level and fix policy are the service's own.
Measurements of one step are condensed into one of the same information: n ranges of white noise sigma into one of sigma /
sqrt(n). The streams' noise counts as known (eq. (16) of docs/explanation/fleet-filter.md), and the level of gusts as the settings
have it: with no noise nothing could be learned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from gcs_coloc.core.aiding.fix_policy import FixPolicy
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m, horizontal_dilution_of
from gcs_coloc.core.integrity.epoch_tests.epoch import (
    COLOURED_SHARE,
    RANGE_BIAS_M,
    Epoch,
    PositionPrior,
    RangeResidual,
    height_sigma_m,
)
from gcs_coloc.core.integrity.other_side import OpenSides
from gcs_coloc.core.integrity.protection_level import VERTICAL_RATIO, Exposure, FaultLevel, fault_level, protection_level
from gcs_coloc.core.integrity.range_residuals import WINDOW_S
from gcs_coloc.core.integrity.solution_separation import SolutionSeparation
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    FloatArray,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
    Vector3,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.core.readiness.vehicle_readiness import limiting_reason, unit_vectors
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NoiseSplit, PairNoise
from gcs_coloc.estimators.fleet.ekf.measurement_models import REPORT_VELOCITY_TIME_S
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import pair_key
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.hypotheses import FleetHypotheses
from gcs_coloc.estimators.fleet.peer_selection import select_peers
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.planning.fleet_plan import FleetPlan, PlannedMotion, planned_attitudes
from gcs_coloc.planning.predicted_flight import PredictedStep, Prediction, as_prediction

STEP_S = 1.0
"""Step of the recursion. Chosen: within a longer one a turn counts as a manoeuvre, and 1.5 s are a gap to the filter."""
STEP_WITH_AIR_DATA_S = 2.0
"""The same of planes with attitude and airspeed, which show their turns. Chosen: sigmas are within 4 % of those with steps of
0.2 s, at a sixth of the cost."""
STEP_BY_KNOWN_NODES_S = 0.4
"""The same where nodes well known locate a vehicle: many ranges taken as of one instant tell more than its motion leaves to them.
Chosen: sigmas are 10 % smaller than with steps of 0.2 s; with steps of 2 s 45 %."""
_WELL_KNOWN_M = 0.5
"""1-sigma of such a node. Chosen: at 0.5 m steps of 2 s still come to 5 % of those of 0.2 s."""
_LEAST_KNOWN_NODES = 2  # chosen: beside one station the peers' errors decide
_LEVEL_EVERY_S = 10.0
"""Chosen: geometry changes little in 10 s; the hypotheses cost as much as a step."""
WITH_GPS_S = 5.0
"""The GPS fails so long after the vehicle's start: its filter begins from its own reports."""
_CHOSEN_EVERY = 5
"""Steps from one choice of peers to the next. Chosen: they are 10 s at most, in which geometry changes little."""
_MEDIAN_VARIANCE_RATIO = 1.57  # pi / 2: variance of a Gaussian sample's median over that of its mean
_KNOWN_WEIGHT = 1e6
"""Samples that a stream's noise counts as known by: no bound on it is left."""


def predict(plan: FleetPlan, denied: tuple[int, ...], step_s: float | None = None) -> list[Prediction]:
    """Predict one or several vehicles whose GPS fails soon after their start, each along its whole way."""
    recursion = _Recursion(plan, denied, step_s if step_s is not None else longest_step_s(plan, denied))
    for k in range(len(recursion.times_s)):
        recursion.step(k)
    return [as_prediction(sysid, denied, recursion.rows[sysid]) for sysid in denied]


def longest_step_s(plan: FleetPlan, denied: tuple[int, ...]) -> float:
    """Return the longest step at which the recursion of some denied vehicles holds, s."""
    known = sum(station.sigma_m < _WELL_KNOWN_M for station in plan.stations)
    known += len(plan.vehicles) - len(denied) if plan.assumptions.position_sigma_m < _WELL_KNOWN_M else 0
    if known >= _LEAST_KNOWN_NODES:
        return STEP_BY_KNOWN_NODES_S
    have_air_data = plan.assumptions.has_air_data and all(plan.vehicle(v).vehicle_class is VehicleClass.PLANE for v in denied)
    return STEP_WITH_AIR_DATA_S if have_air_data else STEP_S


class _Recursion:
    """The filter along the plan with some vehicles denied, step by step.

    `rows` holds its results by denied vehicle.
    """

    def __init__(self, plan: FleetPlan, denied: tuple[int, ...], step_s: float) -> None:
        self._plan, self._denied = plan, denied
        self._begin_s, _ = plan.span_s
        self._a = a = plan.assumptions
        settings = FleetSettings()
        self._filter = FleetHypotheses(settings)
        self._most_peers = settings.peers_per_denied_vehicle
        # Of less than one in a step each tells as much less.
        self._ranges_a_step, reports_a_step = a.range_rate_hz * step_s, a.position_rate_hz * step_s
        self._range_sigma_m = a.range_sigma_m / sqrt(self._ranges_a_step)
        self._report_sigma_m, self._report_white = _condensed(
            a.position_sigma_m, a.position_white_share, reports_a_step, settings.least_coloured_share
        )
        self._velocity_sigma_mps = a.velocity_sigma_mps / sqrt(max(step_s / REPORT_VELOCITY_TIME_S, 1.0))
        self._stations = {station.node: station for station in plan.stations}
        self._policies: dict[int, FixPolicy] = {}
        self._levels: dict[int, FaultLevel] = {}
        self._open_sides = OpenSides(a.protection.max_acceleration_mps2)
        self._levels_due_s = -math.inf
        self._lost: frozenset[int] = frozenset()
        self._chosen: dict[int, frozenset[int]] = {}
        self.rows: dict[int, list[PredictedStep]] = {sysid: [] for sysid in denied}
        paths = [plan.paths[sysid] for sysid in denied]
        first_s, last_s = min(path.begin_s for path in paths), max(path.end_s for path in paths)
        self.times_s: FloatArray = first_s + np.arange(int((last_s - first_s) / step_s) + 1, dtype=float) * step_s
        self._motion = PlannedMotion(plan, self.times_s)
        self._attitudes = {v: planned_attitudes(plan, v, self.times_s, step_s) for v in denied if self._has_air_data(v)}
        self._introduce()

    def step(self, k: int) -> None:
        """Feed the filter with all that is measured in one step, and keep what it states.

        The step ends at `times_s[k]`.
        """
        at_s = self.times_s.item(k)
        here, velocities = self._motion.in_flight(k)
        self._update_denied(at_s, here)
        ranged = {v: self._nodes_in_range(v, here) for v in self._lost}
        used = {v: self._choose(v, units, here, k) for v, units in ranged.items()}
        for sysid in here:
            for attitude in self._attitudes[sysid][k] if sysid in self._attitudes else ():
                self._filter.apply(attitude)
        heard = set(self._denied).union(*used.values())
        for sysid in here:
            if sysid in self._denied and sysid not in self._lost:
                self._open_sides.note_side(sysid, at_s, here[sysid], velocities[sysid])
            if sysid not in self._lost and sysid in heard:
                self._feed_report(sysid, here[sysid], velocities[sysid], at_s)
        for sysid in sorted(self._lost):
            self._feed_height(sysid, here[sysid][2], at_s)
            for node in used[sysid]:
                if node not in self._lost or node > sysid:
                    self._feed_range(sysid, node, here, at_s)
        answers = {v: self._filter.estimate(v, at_s) for v in sorted(self._lost)}
        located = {v: where for v, where in answers.items() if isinstance(where, Estimate)}
        are_levels_due = at_s >= self._levels_due_s
        if are_levels_due or len(self._denied) > 1:
            epoch = self._epoch(located, used, here, at_s)
            if are_levels_due:
                self._levels_due_s = at_s + _LEVEL_EVERY_S
                self._update_levels(located, epoch)
            self._update_other_sides(located, epoch)
        for sysid, answer in answers.items():
            self._keep(sysid, answer, ranged[sysid], here, at_s)

    def _has_air_data(self, sysid: int) -> bool:
        return self._a.has_air_data and self._plan.vehicle(sysid).vehicle_class is VehicleClass.PLANE

    def _introduce(self) -> None:
        for vehicle in self._plan.vehicles:
            self._filter.apply(VehicleClassReport(vehicle.sysid, self._begin_s, self._begin_s, vehicle.vehicle_class))
        for station in self._stations.values():
            place, sigma_m = station.position_enu_m, station.sigma_m
            self._filter.apply(
                PositionMeasurement(station.node, self._begin_s, self._begin_s, place, sigma_m, sigma_m, static=True)
            )

    def _update_denied(self, at_s: float, here: Mapping[int, Vector3]) -> None:
        lost = frozenset(v for v in self._denied if v in here and at_s >= self._plan.paths[v].begin_s + WITH_GPS_S)
        if lost == self._lost:
            return
        self._lost = lost
        self._filter.set_denied(lost, at_s)
        for sysid in lost:
            self._policies.setdefault(sysid, FixPolicy(self._a.aiding, at_s))

    def _nodes_in_range(self, sysid: int, here: Mapping[int, Vector3]) -> dict[int, Vector3]:
        """Return the unit vectors of the nodes that a vehicle ranges, by node.

        Other denied vehicles are among the nodes.
        """
        peers = {v: place for v, place in here.items() if v != sysid}
        peers |= {node: station.position_enu_m for node, station in self._stations.items()}
        return unit_vectors(here[sysid], peers, self._a.max_range_m)

    def _choose(self, sysid: int, units: Mapping[int, Vector3], here: Mapping[int, Vector3], k: int) -> list[int]:
        """Return the nodes in range that the filter would use, chosen as it chooses them."""
        if len(units) <= self._most_peers:
            return list(units)
        kept = self._chosen.get(sysid, frozenset())
        if k % _CHOSEN_EVERY == 0 or len(kept & units.keys()) < self._most_peers:
            placed = [(node, np.array(here.get(node) or self._stations[node].position_enu_m)) for node in units]
            kept = select_peers(np.array(here[sysid]), placed, kept, frozenset(), self._most_peers, height_known=True)
            self._chosen[sysid] = kept
        return [node for node in units if node in kept]

    def _feed_report(self, sysid: int, place: Vector3, velocity: Vector3, at_s: float) -> None:
        sigma_m = self._report_sigma_m
        vertical_m = VERTICAL_RATIO * sigma_m
        for record in self._known_records(sysid):
            record.in_one_step = sysid not in self._denied
            record.report_noise = _known_split((sigma_m, vertical_m), self._report_white)
        self._filter.apply(PositionMeasurement(sysid, at_s, at_s, place, sigma_m, vertical_m, velocity, self._velocity_sigma_mps))

    def _feed_range(self, sysid: int, node: int, here: Mapping[int, Vector3], at_s: float) -> None:
        there = self._stations[node].position_enu_m if node in self._stations else here[node]
        known = _known_split((self._range_sigma_m,), 1.0)
        for model in self._models():
            model.pairs[pair_key(sysid, node, 0)] = PairNoise(known, known)
        range_m, samples = math.dist(here[sysid], there), self._ranges_a_step
        self._filter.apply(RangeMeasurement(sysid, node, at_s, at_s, range_m, self._range_sigma_m, samples=samples))

    def _feed_height(self, sysid: int, up_m: float, at_s: float) -> None:
        sigma_m = self._a.height_sigma_m
        for record in self._known_records(sysid):
            record.altitude_noise = _known_split((sigma_m,), 0.0)
            # Without noise there are no lasting errors of ranges but those of the filter's own model.
            record.bias_window = None
        self._filter.apply(AltitudeMeasurement(sysid, at_s, at_s, up_m, sigma_m))

    def _models(self) -> list[FleetModel]:
        return [self._filter.main, *(each.model for each in self._filter.hypotheses.values())]

    def _known_records(self, sysid: int) -> list[VehicleRecord]:
        """Return the records of a vehicle in all models, with gusts and manoeuvres as the settings have them."""
        self._filter.main.records.writable(sysid)
        records = [model.records.writable(sysid) for model in self._models() if sysid in model.records]
        for record in records:
            record.gust_noise.log_level = record.manoeuvre_noise.log_level = 0.0
        return records

    def _epoch(
        self,
        located: Mapping[int, Estimate],
        used: Mapping[int, Sequence[int]],
        here: Mapping[int, Vector3],
        at_s: float,
    ) -> Epoch:
        a = self._a
        count = max(a.range_rate_hz * WINDOW_S, 1.0)
        noise_m = sqrt(a.range_sigma_m**2 * (_MEDIAN_VARIANCE_RATIO / count + COLOURED_SHARE))
        priors: dict[int, PositionPrior] = {}
        residuals: list[RangeResidual] = []
        for sysid, where in located.items():
            sigma_v_m = height_sigma_m(where.covariance)
            for node in used[sysid]:
                if node in self._lost and node not in located:
                    continue
                if node in located and node < sysid:
                    continue
                priors[sysid] = PositionPrior(here[sysid], 0.0, sigma_v_m, no_prior=True)
                priors.setdefault(node, self._prior(node, located, here))
                residuals.append(RangeResidual(sysid, node, 0.0, noise_m, RANGE_BIAS_M))
        return Epoch(at_s, priors, tuple(residuals))

    def _update_levels(self, located: Mapping[int, Estimate], epoch: Epoch) -> None:
        """Adjust the ranges of the moment under all hypotheses of fault, as the integrity stage does."""
        if not epoch.residuals:
            return
        separation = SolutionSeparation(epoch)
        for sysid, where in located.items():
            if sysid in separation.vehicles:
                hypotheses = separation.expected_of(sysid, where.covariance[:2, :2])
                self._levels[sysid] = fault_level(hypotheses, where, epoch.at_s, self._a.protection)

    def _update_other_sides(self, located: Mapping[int, Estimate], epoch: Epoch) -> None:
        """Follow on which side of their peers vehicles are that range each other, which takes every step."""
        for sysid, where in located.items():
            if sysid in epoch.priors and sysid in self._levels:
                other_side_m = self._open_sides.other_side_m(epoch, sysid, where.velocity_enu_mps.tolist())
                self._levels[sysid] = replace(self._levels[sysid], other_side_m=other_side_m)

    def _prior(self, node: int, located: Mapping[int, Estimate], here: Mapping[int, Vector3]) -> PositionPrior:
        if node in self._stations:
            station = self._stations[node]
            return PositionPrior(station.position_enu_m, station.sigma_m, station.sigma_m, no_prior=False)
        if node in located:
            sigma_v_m = height_sigma_m(located[node].covariance)
            return PositionPrior(here[node], 0.0, sigma_v_m, no_prior=True)
        sigma_m = self._a.position_sigma_m
        return PositionPrior(here[node], sigma_m, VERTICAL_RATIO * sigma_m, no_prior=False)

    def _keep(
        self, sysid: int, answer: Estimate | NoEstimate, ranged: Mapping[int, Vector3], here: Mapping[int, Vector3], at_s: float
    ) -> None:
        a, air_data = self._a, self._has_air_data(sysid)
        bound_m = hpl_m = offset_m = math.nan
        where = answer
        if isinstance(where, Estimate):
            faults = self._levels.get(sysid)
            if faults is not None and ranged:
                # Between two adjustments the ranges go on.
                faults = self._levels[sysid] = replace(faults, ranged_at_s=at_s - 1.0 / a.range_rate_hz)
            level = protection_level(where, faults, Exposure(a.delay_is_known, at_s if air_data else None), a.protection)
            bound_m, hpl_m = horizontal_bound_95_m(where.covariance), level.horizontal_m
            offset_m = hypot(*(where.position_enu_m[:2] - here[sysid][:2]).tolist())
            where = replace(where, protection=level)
        inhibit = self._policies[sysid].inhibit(where, at_s, own_gps=False, air_data=air_data)
        hdop = horizontal_dilution_of(ranged.values()) if len(ranged) >= 2 else math.inf
        limit = limiting_reason(inhibit, where, hdop, tuple(ranged))
        text, code = (limit.text, limit.reason.code) if limit is not None else ("", "")
        self.rows[sysid].append(
            PredictedStep(at_s, here[sysid], hdop, bound_m, hpl_m, offset_m, len(ranged), inhibit is None, text, code)
        )


def _condensed(sigma_m: float, white_share: float, samples: float, least_coloured: float) -> tuple[float, float]:
    """Return the sigma of the mean of some samples, and the white share of it (as a ratio of sigmas).

    `least_coloured` is the least share of a sigma that no averaging removes.
    """
    white_m = sigma_m * white_share
    coloured_m = sqrt(max(sigma_m * sigma_m - white_m * white_m, (least_coloured * sigma_m) ** 2))
    white_m /= sqrt(samples)
    whole_m = hypot(white_m, coloured_m)
    return whole_m, white_m / whole_m


def _known_split(sigmas_m: tuple[float, ...], white_share: float) -> NoiseSplit:
    """Return the split of a stream whose noise is known: this share of its sigma is white."""
    return NoiseSplit((), tuple(((white_share * sigma_m) ** 2 * _KNOWN_WEIGHT, _KNOWN_WEIGHT) for sigma_m in sigmas_m))
