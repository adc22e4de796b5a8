"""The model of the fleet and, for each subject that may be on either side of a line of peers, its twin: the mirror image.

Both take the same measurements. How well each foresees them gives the odds between them. As long as these do not decide, the
answer covers both; once they do, the model that foresees better is the one that is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.bound import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, Measurement, RangeMeasurement, Unknown
from gcs_coloc.estimators.fleet_corrections import Verdict
from gcs_coloc.estimators.fleet_mirror import blend, find_mirror, reflect
from gcs_coloc.estimators.fleet_model import FleetModel
from gcs_coloc.estimators.fleet_settings import FleetSettings

_LOOK_EVERY_S = 0.25
_DECIDED = 12.0
_MOST_NIS = 20.0
_ONE_AGAIN = 0.5


@dataclass(slots=True)
class Twin:
    """A model in which one subject is at its mirror image; `log_odds` is the logarithm of its odds against the main model."""

    model: FleetModel
    log_odds: float = 0.0


class FleetHypotheses:
    """The main model and its twins, by subject. `copy` is an independent copy; everything else changes it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.main = FleetModel(settings)
        self.twins: dict[int, Twin] = {}
        self._looked_at_s: dict[int, float] = {}

    def copy(self) -> FleetHypotheses:
        """Return an independent copy."""
        other = object.__new__(FleetHypotheses)
        other.main = self.main.copy()
        other.twins = {subject: Twin(twin.model.copy(), twin.log_odds) for subject, twin in self.twins.items()}
        other._looked_at_s = dict(self._looked_at_s)
        return other

    def set_subjects(self, subjects: frozenset[int], at_s: float) -> None:
        """Change who is to be located, as `FleetModel.set_subjects` does."""
        self.main.set_subjects(subjects, at_s)
        self.twins = {subject: twin for subject, twin in self.twins.items() if subject in subjects}
        for twin in self.twins.values():
            twin.model.set_subjects(subjects & twin.model.records.keys(), at_s)

    def apply(self, m: Measurement) -> Verdict:
        """Take one measurement, not older than any before it."""
        ends = (m.from_vehicle, m.to_vehicle) if isinstance(m, RangeMeasurement) else (m.vehicle,)
        if not self.twins:
            verdict = self.main.apply(m)
        else:
            concerned = [twin for twin in self.twins.values() if any(v in twin.model.clusters for v in ends)]
            for twin in concerned:
                twin.model.learn(self.main, ends)
            verdict = self.main.apply(m)
            for twin in concerned:
                twin.log_odds += _evidence(verdict, twin.model.apply(m))
        if isinstance(m, RangeMeasurement):
            for vehicle in ends:
                is_due = m.measured_at_s - self._looked_at_s.get(vehicle, -math.inf) >= _LOOK_EVERY_S
                if is_due and self.main.records[vehicle].subject:
                    self._look(vehicle, m.measured_at_s)
        return verdict

    def _look(self, subject: int, at_s: float) -> None:
        """Decide between a subject and its mirror image, or see whether there is one."""
        self._looked_at_s[subject] = at_s
        cluster = self.main.clusters.get(subject)
        twin = self.twins.get(subject)
        if cluster is None:
            self.twins.pop(subject, None)
            return
        if twin is not None:
            other = twin.model.clusters.get(subject)
            if other is None or twin.log_odds < -_DECIDED:
                del self.twins[subject]
                return
            if twin.log_odds > _DECIDED:
                self.main.take_over(twin.model, subject)
                del self.twins[subject]
                return
            x, P = cluster.predicted(subject, at_s)
            other_x, other_P = other.predicted(subject, at_s)
            d, S = (other_x - x)[:6], (P + other_P)[:6, :6]
            if float(d @ np.linalg.solve(S, d)) < _ONE_AGAIN:
                del self.twins[subject]
            return
        mirror = find_mirror(cluster, subject, at_s)
        if mirror is not None:
            model = FleetModel(self.main.settings)
            model.take_over(self.main, subject)
            reflect(model.clusters[subject], subject, mirror)
            self.twins[subject] = Twin(model)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | Unknown:
        """Answer from the state as it stands: what covers all that is possible, or that it is ambiguous."""
        where = self.main.estimate(vehicle, at_s)
        for twin in self.twins.values():
            if isinstance(where, Unknown):
                return where
            if vehicle not in twin.model.clusters:
                continue
            other = twin.model.estimate(vehicle, at_s)
            if isinstance(other, Unknown):
                return other
            x = np.concatenate([where.position_enu_m, where.velocity_enu_mps])
            other_x = np.concatenate([other.position_enu_m, other.velocity_enu_mps])
            mean, covariance = blend(x, where.covariance, other_x, other.covariance, twin.log_odds)
            if horizontal_sigma_m(covariance) > self.main.settings.limit_sigma_m:
                apart_m = math.hypot(*(other_x - x)[:2].tolist())
                reason = f"ambiguous: another place, {apart_m:.0f} m from the first, fits the ranges as well"
                return Unknown(vehicle, at_s, reason)
            where = Estimate(vehicle, at_s, mean[:3], mean[3:], covariance, where.hdop, where.ranges_in_use)
        return where


def _evidence(main: Verdict, twin: Verdict) -> float:
    """Return by how much a measurement raises the log odds of the twin: one that neither foresees tells little."""
    if main.degrees_of_freedom == 0 or twin.degrees_of_freedom == 0:
        return 0.0
    gain = 0.5 * (min(main.nis, _MOST_NIS) - min(twin.nis, _MOST_NIS))
    if main.sigma_m > 0.0 and twin.sigma_m > 0.0:
        gain += math.log(main.sigma_m / twin.sigma_m)
    return gain
