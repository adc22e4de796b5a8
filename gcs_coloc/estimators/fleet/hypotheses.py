"""Multiple hypotheses: the main model and, for a denied vehicle on an unknown side of its peers, the reflected one.

Both are updated with the same measurements. Their likelihoods give the odds, eq. (24). Until the odds decide, an estimate is
the mixture of both; then the likelier model is kept (Bar-Shalom, Li, Kirubarajan 2001, section 11.6, static multiple models).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, auto

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
    ReflectionPlane,
    find_reflection_plane,
    mixture,
    offset_sigmas,
    only_motion_separates,
    reflect,
    vertical_plane_through_line,
)
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster
from gcs_coloc.estimators.fleet.ekf.gap import HORIZONTAL
from gcs_coloc.estimators.fleet.ekf.outcomes import UpdateResult
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.settings import FleetSettings

_TEST_EVERY_S = 0.25
"""Chosen: a reflection develops over seconds; a test costs about as much as an update."""
_GAP_S = 1.0
"""Chosen: after a gap of this length the estimate is saved to test the side that the next ranges confirm."""
_DECIDED_LOG_ODDS = 12.0
"""Chosen: odds of 160,000; a wrong decision is confident and lasts."""
_MOST_NIS = 20.0
"""Chosen: bounds the evidence of one measurement: an outlier of both models says little."""
_STATED_LOG_ODDS = 6.0
"""Chosen: odds of 400; below them two places that are apart are no estimate but ambiguous."""
_APART_NIS = 16.0
"""Chosen: as the gate; half way between two places their mean is beyond it for both."""
_MERGED_NIS = 0.5
"""Chosen: hypotheses closer than 0.7 sigma of six components are merged."""
_CLEARLY_ASIDE_SIGMAS = 1.0
"""Chosen: within one sigma of the plane a state is on neither side."""
_MANOEUVRE_S = 3.0
"""Chosen: an unmodelled manoeuvre is in all innovations of so long; they are one piece of evidence."""
_MOST_OF_MOTION = 3.0
"""Chosen: bounds the log odds that one such manoeuvre contributes."""


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
    """A model in which one denied vehicle is reflected; `log_odds` is the logarithm of its odds against the main model.

    `motion_only`: only the process model separates the two. `separated`: in the last test they were on opposite sides.
    """

    model: FleetModel
    motion_only: bool
    log_odds: float = 0.0
    separated: bool = True
    _since_s: float = -math.inf
    _before: float = 0.0
    _raised: float = 0.0

    def add_evidence(self, gain: float, at_s: float) -> None:
        """Add the log-likelihood ratio of one measurement to the log odds, bounded where only motion separates, eq. (24)."""
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


class FleetHypotheses:
    """The main model and its reflection hypotheses, by denied vehicle; all methods but `copy` change it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.main = FleetModel(settings)
        self.hypotheses: dict[int, ReflectionHypothesis] = {}
        self._tested_at_s: dict[int, float] = {}
        self._saved: dict[int, SavedEstimate] = {}

    def copy(self) -> FleetHypotheses:
        """Return an independent copy."""
        other = object.__new__(FleetHypotheses)
        other.main = self.main.copy()
        other.hypotheses = {v: replace(h, model=h.model.copy()) for v, h in self.hypotheses.items()}
        other._tested_at_s = dict(self._tested_at_s)
        other._saved = dict(self._saved)
        return other

    def set_denied(self, denied: frozenset[int], at_s: float) -> None:
        """Change which vehicles are denied, as `FleetModel.set_denied` does."""
        self.main.set_denied(denied, at_s)
        self.hypotheses = {v: h for v, h in self.hypotheses.items() if v in denied}
        self._tested_at_s = {v: then_s for v, then_s in self._tested_at_s.items() if v in denied}
        self._saved = {v: saved for v, saved in self._saved.items() if v in denied}
        for hypothesis in self.hypotheses.values():
            hypothesis.model.set_denied(denied & hypothesis.model.records.keys(), at_s)

    def apply(self, m: Measurement) -> UpdateResult:
        """Update all models with one measurement, not older than any before it."""
        ends = (m.from_vehicle, m.to_vehicle) if isinstance(m, RangeMeasurement) else (m.vehicle,)
        if isinstance(m, RangeMeasurement):
            self._save_before_gap(m)
        if not self.hypotheses:
            result = self.main.apply(m)
        else:
            concerned = [h for h in self.hypotheses.values() if any(v in h.model.clusters for v in ends)]
            for hypothesis in concerned:
                hypothesis.model.import_vehicles(self.main, ends)
            result = self.main.apply(m)
            for hypothesis in concerned:
                gain = _evidence(result, hypothesis.model.apply(m))
                hypothesis.add_evidence(gain, m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            for vehicle in ends:
                is_due = m.measured_at_s - self._tested_at_s.get(vehicle, -math.inf) >= _TEST_EVERY_S
                if is_due and self.main.records[vehicle].denied_vehicle:
                    self._test(vehicle, m.measured_at_s)
        return result

    def _save_before_gap(self, m: RangeMeasurement) -> None:
        """Save the predicted estimate of the denied vehicles of a range that is the first after a gap."""
        for denied_vehicle in (m.from_vehicle, m.to_vehicle):
            gap_s = m.measured_at_s - self._tested_at_s.get(denied_vehicle, math.inf)
            cluster = self.main.clusters.get(denied_vehicle)
            if gap_s > _GAP_S and cluster is not None:
                self._saved[denied_vehicle] = save_estimate(cluster, denied_vehicle, m.measured_at_s)

    def _test(self, denied_vehicle: int, at_s: float) -> None:
        """Test whether a denied vehicle has a reflection, or decide between it and its hypothesis."""
        self._tested_at_s[denied_vehicle] = at_s
        cluster = self.main.clusters.get(denied_vehicle)
        hypothesis = self.hypotheses.get(denied_vehicle)
        before = self._saved.pop(denied_vehicle, None)
        if cluster is None:
            self.hypotheses.pop(denied_vehicle, None)
            return
        self._saved[denied_vehicle] = save_estimate(cluster, denied_vehicle)
        if hypothesis is None:
            evidence = self.main.records[denied_vehicle].reflection_evidence
            plane = plane_of_refused_ranges(evidence, cluster, denied_vehicle, at_s)
            plane = plane or find_reflection_plane(cluster, denied_vehicle, at_s)
            if plane is None and before is not None:
                plane = plane_after_gap(before, cluster, denied_vehicle, at_s)
            if plane is not None:
                self.main.records.writable(denied_vehicle).reflection_evidence = None
                self._branch(denied_vehicle, plane, at_s)
            return
        other = hypothesis.model.clusters.get(denied_vehicle)
        if other is None:
            del self.hypotheses[denied_vehicle]
            return
        plane = vertical_plane_through_line(cluster, denied_vehicle, at_s)
        sides = RelativeSide.APART if plane is None else _sides(cluster, other, denied_vehicle, plane)
        if sides is RelativeSide.APART and not hypothesis.separated:
            # From the plane either side was reached by chance: the odds so far are of another question.
            hypothesis.reset_odds()
        hypothesis.separated = sides is RelativeSide.APART
        hypothesis.motion_only = only_motion_separates(cluster, denied_vehicle, at_s, plane)
        if sides is RelativeSide.SAME or abs(hypothesis.log_odds) > _DECIDED_LOG_ODDS:
            if hypothesis.log_odds > 0.0:
                self.main.replace_from(hypothesis.model, denied_vehicle)
            del self.hypotheses[denied_vehicle]
            cluster = self.main.clusters[denied_vehicle]
            if plane is not None and not hypothesis.separated and _is_aside(cluster, denied_vehicle, plane):
                # No hypothesis was on the other side, so nothing has ruled it out.
                self._branch(denied_vehicle, plane, at_s)
            return
        x, P = cluster.predict(denied_vehicle, at_s)
        other_x, other_P = other.predict(denied_vehicle, at_s)
        d, S = (other_x - x)[:6], (P + other_P)[:6, :6]
        if float(d @ np.linalg.solve(S, d)) < _MERGED_NIS:
            del self.hypotheses[denied_vehicle]

    def _branch(self, denied_vehicle: int, plane: ReflectionPlane, at_s: float) -> None:
        """Add the hypothesis that a denied vehicle is reflected in a plane."""
        cluster = self.main.clusters[denied_vehicle]
        line = vertical_plane_through_line(cluster, denied_vehicle, at_s)
        motion_only = only_motion_separates(cluster, denied_vehicle, at_s, line)
        model = FleetModel(self.main.settings)
        model.replace_from(self.main, denied_vehicle)
        reflect(model.clusters[denied_vehicle], denied_vehicle, plane)
        self.hypotheses[denied_vehicle] = ReflectionHypothesis(model, motion_only)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return the mixture of all hypotheses, eq. (25), with what no range has ruled out since a gap, or why there is none."""
        where, record = self._mixture(vehicle, at_s), self.main.records.get(vehicle)
        if isinstance(where, NoEstimate) or record is None or record.unshown is None:
            return where
        covariance, unshown = where.covariance.copy(), record.unshown.covariance(at_s)
        covariance[HORIZONTAL] += unshown
        worst_m = horizontal_sigma_m(covariance)
        if not worst_m <= self.main.settings.limit_sigma_m:
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.TOO_UNCERTAIN, worst_m))
        far = None if where.far_covariance is None else where.far_covariance + unshown[:2, :2]
        return replace(where, covariance=covariance, far_covariance=far)

    def _mixture(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return the mixture of all hypotheses, eq. (25), or that the position is ambiguous."""
        where = self.main.estimate(vehicle, at_s)
        for hypothesis in self.hypotheses.values():
            if isinstance(where, NoEstimate):
                return where
            if vehicle not in hypothesis.model.clusters:
                continue
            other = hypothesis.model.estimate(vehicle, at_s)
            if isinstance(other, NoEstimate):
                return other
            x = np.concatenate([where.position_enu_m, where.velocity_enu_mps])
            other_x = np.concatenate([other.position_enu_m, other.velocity_enu_mps])
            mean, covariance = mixture(x, where.covariance, other_x, other.covariance, hypothesis.log_odds)
            open_sides = abs(hypothesis.log_odds) < _STATED_LOG_ODDS and _are_apart(where, other)
            if open_sides or horizontal_sigma_m(covariance) > self.main.settings.limit_sigma_m:
                apart_m = math.hypot(*(other_x - x)[:2].tolist())
                return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER_PLACE, apart_m))
            far = None
            if where.far_covariance is not None or other.far_covariance is not None:
                pair = where.protected_covariance, other.protected_covariance
                far = mixture(x[:2], pair[0], other_x[:2], pair[1], hypothesis.log_odds)[1]
            where = Estimate(vehicle, at_s, mean[:3], mean[3:], covariance, where.hdop, where.ranges_in_use, None, far)
        return where


def _are_apart(a: Estimate, b: Estimate) -> bool:
    """Whether the mean of two estimates is at neither: no mixture of them is a place."""
    d = (b.position_enu_m - a.position_enu_m)[:2]
    return min(float(d @ np.linalg.solve(one.covariance[:2, :2], d)) for one in (a, b)) > 4.0 * _APART_NIS


def _sides(cluster: Cluster, other: Cluster, denied_vehicle: int, plane: ReflectionPlane) -> RelativeSide:
    away, other_away = offset_sigmas(cluster, denied_vehicle, plane), offset_sigmas(other, denied_vehicle, plane)
    if min(abs(away), abs(other_away)) < _CLEARLY_ASIDE_SIGMAS:
        return RelativeSide.OPEN
    return RelativeSide.SAME if away * other_away > 0.0 else RelativeSide.APART


def _is_aside(cluster: Cluster, denied_vehicle: int, plane: ReflectionPlane) -> bool:
    return abs(offset_sigmas(cluster, denied_vehicle, plane)) >= _CLEARLY_ASIDE_SIGMAS


def _evidence(main: UpdateResult, hypothesis: UpdateResult) -> float:
    """Return the log-likelihood ratio of a measurement, hypothesis against main model, eq. (24)."""
    if main.degrees_of_freedom == 0 or hypothesis.degrees_of_freedom == 0:
        return 0.0
    gain = 0.5 * (min(main.nis, _MOST_NIS) - min(hypothesis.nis, _MOST_NIS))
    if main.sigma_m > 0.0 and hypothesis.sigma_m > 0.0:
        gain += math.log(main.sigma_m / hypothesis.sigma_m)
    return gain
