"""Hypotheses: the main model, and models in which denied vehicles are reflected.

A denied vehicle is reflected where it may be on the other side of its peers. All are updated with the same measurements. Their
likelihoods give the odds, eq. (24). Until the odds decide, an estimate is the mixture of all; then the likelier model is kept
(Bar-Shalom, Li, Kirubarajan 2001, section 11.6, static multiple models).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, NoEstimateReason, RangeMeasurement, Unlocated
from gcs_coloc.estimators.fleet.ambiguity.range_evidence import (
    SavedEstimate,
    plane_after_gap,
    plane_of_refused_ranges,
    save_estimate,
)
from gcs_coloc.estimators.fleet.ambiguity.reflection import (
    CLEARLY_ASIDE_SIGMAS,
    ReflectionPlane,
    find_joint_reflection,
    find_reflected_start,
    find_reflection_plane,
    may_peers_have_moved,
    mixture,
    offset_sigmas,
    only_motion_separates,
    reflect,
    vertical_plane_through_line,
)
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.estimates import with_possible_motion
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.reflection_hypothesis import (
    ReflectionHypothesis,
    RelativeSide,
    is_merged,
    log_likelihood_ratio,
    relative_side,
)
from gcs_coloc.estimators.fleet.searched_vehicles import search_of, search_with
from gcs_coloc.estimators.fleet.settings import FleetSettings

_TEST_EVERY_S = 0.25  # chosen: a reflection develops over seconds; a test costs about as much as an update
_GAP_S = 1.0  # chosen: after a gap of this length the estimate is saved to test the side that the next ranges confirm
_DECIDED_LOG_ODDS = 12.0  # chosen: odds of 160,000; a wrong decision is confident and lasts
_STATED_LOG_ODDS = 6.0  # chosen: odds of 400; below them two places that are apart are no estimate but ambiguous
_APART_NIS = 16.0  # chosen: as the gate; half way between two places their mean is beyond it for both
_MOST_HYPOTHESES = 16
"""Chosen: bounds the computing; with so many none is opened for several vehicles together. Five near one line had seven."""


class FleetHypotheses:
    """The main model and its reflection hypotheses, by the denied vehicles that are reflected.

    All methods but `copy` and `estimate` change it in place.
    """

    def __init__(self, settings: FleetSettings) -> None:
        self.main = FleetModel(settings)
        self.hypotheses: dict[frozenset[int], ReflectionHypothesis] = {}
        self._tested_at_s: dict[int, float] = {}
        self._saved: dict[int, SavedEstimate] = {}

    def copy(self) -> FleetHypotheses:
        """Return an independent copy."""
        other = object.__new__(FleetHypotheses)
        other.main = self.main.copy()
        other.hypotheses = {group: replace(h, model=h.model.copy()) for group, h in self.hypotheses.items()}
        other._tested_at_s = dict(self._tested_at_s)
        other._saved = dict(self._saved)
        return other

    def set_denied(self, denied: frozenset[int], at_s: float) -> None:
        """Change which vehicles are denied, as `FleetModel.set_denied` does."""
        self.main.set_denied(denied, at_s)
        self.hypotheses = {group: h for group, h in self.hypotheses.items() if group <= denied}
        self._tested_at_s = {v: then_s for v, then_s in self._tested_at_s.items() if v in denied}
        self._saved = {v: saved for v, saved in self._saved.items() if v in denied}
        for hypothesis in self.hypotheses.values():
            hypothesis.model.set_denied(denied & hypothesis.model.records.keys(), at_s)

    def apply(self, m: Measurement) -> UpdateResult:
        """Update all models with one measurement, not older than any before it."""
        ends = m.ends if isinstance(m, RangeMeasurement) else (m.vehicle,)
        if isinstance(m, RangeMeasurement):
            self._save_before_gap(m)
        if not self.hypotheses:
            result = self.main.apply(m)
        else:
            concerned = {group: h for group, h in self.hypotheses.items() if any(v in h.model.clusters for v in ends)}
            for hypothesis in concerned.values():
                hypothesis.model.import_vehicles(self.main, ends)
            open_sides = frozenset[int]().union(*self.hypotheses)
            result = self.main.apply(m, open_sides)
            for group, hypothesis in concerned.items():
                may_climb = hypothesis.motion_only and not all(self.main.records[vehicle].has_height for vehicle in group)
                gain = log_likelihood_ratio(result, hypothesis.model.apply(m, open_sides), may_climb=may_climb)
                hypothesis.add_evidence(gain, m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            for vehicle in ends:
                self._search_all_places(vehicle, m.measured_at_s)
                is_due = m.measured_at_s - self._tested_at_s.get(vehicle, -math.inf) >= _TEST_EVERY_S
                if is_due and self.main.records[vehicle].denied_vehicle:
                    self._test(vehicle, m.measured_at_s)
        return result

    def _search_all_places(self, vehicle: int, at_s: float) -> None:
        """Search a vehicle at the places of all models once one searches it: its hypotheses end."""
        of_vehicle = {group: h for group, h in self.hypotheses.items() if vehicle in group}
        if not of_vehicle:
            return
        models = [(self.main, 0.0), *((h.model, h.log_odds) for h in of_vehicle.values())]
        if all(vehicle in model.clusters for model, _ in models):
            return
        found = [(search_of(model.clusters, vehicle, at_s), log_odds) for model, log_odds in models]
        places = [(search, log_odds) for search, log_odds in found if search is not None]
        if len(places) > 1 or (places and vehicle not in self.main.clusters):
            (first, reference), *others = places
            search = first.joined([(other, log_odds - reference) for other, log_odds in others])
            search_with(self.main.clusters, vehicle, search)
        for group in of_vehicle:
            del self.hypotheses[group]

    def _save_before_gap(self, m: RangeMeasurement) -> None:
        """Save the predicted estimate of the denied vehicles of a range that is the first after a gap."""
        for denied_vehicle in m.ends:
            gap_s = m.measured_at_s - self._tested_at_s.get(denied_vehicle, math.inf)
            cluster = self.main.clusters.get(denied_vehicle)
            if gap_s > _GAP_S and cluster is not None:
                self._saved[denied_vehicle] = save_estimate(cluster, denied_vehicle, m.measured_at_s)

    def _test(self, denied_vehicle: int, at_s: float) -> None:
        """Decide between a denied vehicle and its hypotheses, and test whether it has others."""
        self._tested_at_s[denied_vehicle] = at_s
        before = self._saved.pop(denied_vehicle, None)
        if denied_vehicle not in self.main.clusters:
            return
        groups = [group for group in self.hypotheses if denied_vehicle in group]
        self._saved[denied_vehicle] = save_estimate(self.main.clusters[denied_vehicle], denied_vehicle)
        for group in groups:
            if group in self.hypotheses:
                self._decide(group, at_s)
        cluster = self.main.clusters[denied_vehicle]
        if not self._is_tested(frozenset({denied_vehicle}), groups):
            plane = self._reflection_plane(cluster, denied_vehicle, before, at_s)
            if plane is not None:
                self.main.records.writable(denied_vehicle).reflection_evidence = None
                self._branch({denied_vehicle: plane}, at_s)
        joint = None if len(self.hypotheses) >= _MOST_HYPOTHESES else find_joint_reflection(cluster, denied_vehicle, at_s)
        if joint is not None and not self._is_tested(frozenset(joint), groups):
            self._branch(joint, at_s)

    def _is_tested(self, group: frozenset[int], decided: list[frozenset[int]]) -> bool:
        """Whether a hypothesis for some denied vehicles is there, or has just been decided."""
        return group in self.hypotheses or group in decided

    def _reflection_plane(
        self, cluster: Cluster, denied_vehicle: int, before: SavedEstimate | None, at_s: float
    ) -> ReflectionPlane | None:
        """Return the plane on whose other side a denied vehicle may be, for it alone and no group, or None."""
        evidence = self.main.records[denied_vehicle].reflection_evidence
        plane = plane_of_refused_ranges(evidence, cluster, denied_vehicle, at_s)
        plane = plane or find_reflection_plane(cluster, denied_vehicle, at_s)
        if plane is None and before is not None:
            plane = plane_after_gap(before, cluster, denied_vehicle, at_s)
        if plane is None and self.main.records[denied_vehicle].began_on_either_side:
            plane = find_reflected_start(cluster, denied_vehicle, at_s)
        return plane

    def _decide(self, group: frozenset[int], at_s: float) -> None:
        """Decide, where possible, between the main model and the hypothesis that a `group` is reflected."""
        hypothesis = self.hypotheses[group]
        cluster, other = _common(self.main, group), _common(hypothesis.model, group)
        if cluster is None or other is None:
            del self.hypotheses[group]
            return
        planes = {vehicle: vertical_plane_through_line(cluster, vehicle, at_s, group) for vehicle in sorted(group)}
        sides = {vehicle: relative_side(cluster, other, vehicle, plane, at_s) for vehicle, plane in planes.items()}
        is_apart = RelativeSide.APART in sides.values()
        if is_apart and not hypothesis.separated:
            # From the plane either side was reached by chance: the odds so far are of another question.
            hypothesis.reset_odds()
        hypothesis.separated = is_apart
        # Ranges to one that has come to the same side separate the others.
        moved = frozenset(vehicle for vehicle, side in sides.items() if side is not RelativeSide.SAME) or group
        line = vertical_plane_through_line(cluster, min(moved), at_s, moved)
        hypothesis.motion_only = only_motion_separates(cluster, moved, at_s, line)
        hypothesis.peers_may_move = may_peers_have_moved(cluster, moved, at_s)
        if set(sides.values()) == {RelativeSide.SAME} or abs(hypothesis.log_odds) > _DECIDED_LOG_ODDS:
            del self.hypotheses[group]
            if hypothesis.log_odds > 0.0:
                self._replace_main(group, hypothesis)
            if abs(hypothesis.log_odds) > _DECIDED_LOG_ODDS:
                for vehicle in group:
                    self.main.records.writable(vehicle).began_on_either_side = False
            cluster = self.main.clusters[min(group)]
            found = {vehicle: plane for vehicle, plane in planes.items() if plane is not None}
            if (
                not hypothesis.separated
                and len(found) == len(planes)
                and all(abs(offset_sigmas(cluster, v, plane, at_s)) >= CLEARLY_ASIDE_SIGMAS for v, plane in found.items())
            ):
                # No hypothesis was on the other side, so nothing has ruled it out.
                self._branch(found, at_s)
        elif all(is_merged(cluster, other, vehicle, at_s) for vehicle in group):
            del self.hypotheses[group]

    def _replace_main(self, group: frozenset[int], won: ReflectionHypothesis) -> None:
        """Replace the main model by a hypothesis that won; the others are compared with the new one."""
        self.main.replace_from(won.model, min(group))
        others: dict[frozenset[int], ReflectionHypothesis] = {}
        for reflected, hypothesis in self.hypotheses.items():
            if not reflected.isdisjoint(group) or reflected | group in self.hypotheses:
                hypothesis.compare_with(won)
                others[reflected ^ group] = hypothesis
            else:
                others[reflected] = hypothesis
        self.hypotheses = others

    def _branch(self, planes: Mapping[int, ReflectionPlane], at_s: float) -> None:
        """Add the hypothesis that some denied vehicles are reflected, each in a plane."""
        group = frozenset(planes)
        first = min(group)
        cluster = self.main.clusters[first]
        line = vertical_plane_through_line(cluster, first, at_s, group)
        motion_only = only_motion_separates(cluster, group, at_s, line)
        peers_may_move = may_peers_have_moved(cluster, group, at_s)
        model = FleetModel(self.main.settings)
        model.replace_from(self.main, first)
        for vehicle, plane in planes.items():
            reflect(model.clusters[vehicle], vehicle, plane)
            record = model.records.writable(vehicle)
            record.air_check = record.air_check.reflected()
        self.hypotheses[group] = ReflectionHypothesis(model, motion_only, peers_may_move)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return the mixture of all hypotheses, eq. (25), or why there is no estimate.

        The estimate holds what no range has ruled out since a gap.
        """
        where, record = self._mixture(vehicle, at_s), self.main.records.get(vehicle)
        if isinstance(where, NoEstimate) or record is None:
            return where
        return with_possible_motion(where, record, self.main.settings)

    def _mixture(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return the mixture of all hypotheses, eq. (25), or that the position is ambiguous."""
        where = self.main.estimate(vehicle, at_s)
        if isinstance(where, NoEstimate):
            return where
        places, log_odds = [where], [0.0]
        for hypothesis in self.hypotheses.values():
            if vehicle not in hypothesis.model.clusters:
                continue
            other = hypothesis.model.estimate(vehicle, at_s)
            if isinstance(other, NoEstimate):
                return other
            places.append(other)
            log_odds.append(hypothesis.log_odds)
        if len(places) == 1:
            return where
        likeliest = int(np.argmax(log_odds))
        is_open = any(
            log_odds[likeliest] - odds < _STATED_LOG_ODDS and _are_apart(places[likeliest], place)
            for place, odds in zip(places, log_odds, strict=True)
        )
        means = [np.concatenate([place.position_enu_m, place.velocity_enu_mps]) for place in places]
        mean, covariance = mixture(means, [place.covariance for place in places], log_odds)
        if is_open or horizontal_sigma_m(covariance) > self.main.settings.limit_sigma_m:
            apart_m = max(math.dist(means[likeliest][:2], each[:2]) for each in means)
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER_PLACE, apart_m))
        far = None
        if any(place.far_covariance is not None for place in places):
            far = mixture([each[:2] for each in means], [place.protected_covariance for place in places], log_odds)[1]
        refuses = any(place.refuses_air_data for place in places)
        air_s, hdop, ranges = min(place.air_data_at_s for place in places), where.hdop, where.ranges_in_use
        return Estimate(vehicle, at_s, mean[:3], mean[3:], covariance, hdop, ranges, None, far, refuses, air_s)


def _are_apart(a: Estimate, b: Estimate) -> bool:
    """Return whether the mean of two estimates is at neither place: no mixture of them is a place."""
    d = (b.position_enu_m - a.position_enu_m)[:2]
    return min(float(d @ np.linalg.solve(one.covariance[:2, :2], d)) for one in (a, b)) > 4.0 * _APART_NIS


def _common(model: FleetModel, group: frozenset[int]) -> Cluster | None:
    """Return the cluster that holds all of some vehicles, None if none does."""
    first = min(group)
    return model.clusters.get(first) if all(model.clusters.common(first, vehicle) is not None for vehicle in group) else None
