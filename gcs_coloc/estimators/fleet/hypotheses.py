"""The model of the fleet and, for each denied vehicle that may be on either side of a line of peers, its twin: the mirror image.

Both take the same measurements. How well each foresees them gives the odds between them. As long as these do not decide, the
answer covers both; once they do, the model that foresees better is the one that is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, RangeMeasurement
from gcs_coloc.estimators.fleet.cluster import Cluster
from gcs_coloc.estimators.fleet.corrections import UpdateResult
from gcs_coloc.estimators.fleet.lost_side import Held, find_lost_side, held
from gcs_coloc.estimators.fleet.mirror import (
    Mirror,
    away_sigmas,
    blend,
    find_mirror,
    reflect,
    through_line,
    told_by_motion,
)
from gcs_coloc.estimators.fleet.model import FleetModel
from gcs_coloc.estimators.fleet.other_side import find_other_side
from gcs_coloc.estimators.fleet.settings import FleetSettings

_LOOK_EVERY_S = 0.25
_GAP_S = 1.0
_DECIDED = 12.0
_MOST_NIS = 20.0
_ONE_AGAIN = 0.5
_CLEARLY_ASIDE = 1.0
_MANOEUVRE_S = 3.0
_MOST_OF_MOTION = 3.0


class Sides(Enum):
    """Where a vehicle is in a model and in its twin: on opposite sides of a line, on the same one, or one of them near it."""

    APART = auto()
    SAME = auto()
    OPEN = auto()


@dataclass(slots=True)
class Twin:
    """A model in which one denied vehicle is at its mirror image; `log_odds` is the logarithm of its odds against the main model.

    `apart`: each of the two was clearly on its own side when last looked at; `by_motion`: only the motion told the two apart.
    """

    model: FleetModel
    by_motion: bool
    log_odds: float = 0.0
    apart: bool = True
    _since_s: float = -math.inf
    _before: float = 0.0
    _raised: float = 0.0

    def weigh(self, gain: float, at_s: float) -> None:
        """Take what a measurement adds to the log odds.

        A manoeuvre that a model does not foresee is in all its innovations until it is noticed. So where only the motion
        tells the two models apart what is heard within three seconds is one, bounded, piece of evidence.
        """
        if not self.by_motion:
            self.log_odds += gain
            self._since_s = -math.inf
            return
        if at_s - self._since_s > _MANOEUVRE_S:
            self._since_s, self._before, self._raised = at_s, self.log_odds, 0.0
        self._raised += gain
        self.log_odds = self._before + min(max(self._raised, -_MOST_OF_MOTION), _MOST_OF_MOTION)

    def forget(self) -> None:
        """Begin with even odds again."""
        self.log_odds, self._since_s = 0.0, -math.inf


class FleetHypotheses:
    """The main model and its twins, by denied vehicle. `copy` is an independent copy; everything else changes it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.main = FleetModel(settings)
        self.twins: dict[int, Twin] = {}
        self._looked_at_s: dict[int, float] = {}
        self._held: dict[int, Held] = {}

    def copy(self) -> FleetHypotheses:
        """Return an independent copy."""
        other = object.__new__(FleetHypotheses)
        other.main = self.main.copy()
        other.twins = {denied_vehicle: replace(twin, model=twin.model.copy()) for denied_vehicle, twin in self.twins.items()}
        other._looked_at_s = dict(self._looked_at_s)
        other._held = dict(self._held)
        return other

    def set_denied(self, denied: frozenset[int], at_s: float) -> None:
        """Change who is to be located, as `FleetModel.set_denied` does."""
        self.main.set_denied(denied, at_s)
        self.twins = {denied_vehicle: twin for denied_vehicle, twin in self.twins.items() if denied_vehicle in denied}
        self._looked_at_s = {
            denied_vehicle: then_s for denied_vehicle, then_s in self._looked_at_s.items() if denied_vehicle in denied
        }
        self._held = {denied_vehicle: then for denied_vehicle, then in self._held.items() if denied_vehicle in denied}
        for twin in self.twins.values():
            twin.model.set_denied(denied & twin.model.records.keys(), at_s)

    def apply(self, m: Measurement) -> UpdateResult:
        """Take one measurement, not older than any before it."""
        ends = (m.from_vehicle, m.to_vehicle) if isinstance(m, RangeMeasurement) else (m.vehicle,)
        if isinstance(m, RangeMeasurement):
            self._note_gaps(m)
        if not self.twins:
            verdict = self.main.apply(m)
        else:
            concerned = [twin for twin in self.twins.values() if any(v in twin.model.clusters for v in ends)]
            for twin in concerned:
                twin.model.learn(self.main, ends)
            verdict = self.main.apply(m)
            for twin in concerned:
                gain = _evidence(verdict, twin.model.apply(m))
                twin.weigh(gain, m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            for vehicle in ends:
                is_due = m.measured_at_s - self._looked_at_s.get(vehicle, -math.inf) >= _LOOK_EVERY_S
                if is_due and self.main.records[vehicle].denied_vehicle:
                    self._look(vehicle, m.measured_at_s)
        return verdict

    def _note_gaps(self, m: RangeMeasurement) -> None:
        """Note where the denied vehicles of a range are held to be just before it, where it is the first for a while."""
        for denied_vehicle in (m.from_vehicle, m.to_vehicle):
            if (
                m.measured_at_s - self._looked_at_s.get(denied_vehicle, math.inf) > _GAP_S
                and denied_vehicle in self.main.clusters
            ):
                self._held[denied_vehicle] = held(self.main.clusters[denied_vehicle], denied_vehicle, m.measured_at_s)

    def _look(self, denied_vehicle: int, at_s: float) -> None:
        """Decide between a denied vehicle and its mirror image, or see whether there is one."""
        self._looked_at_s[denied_vehicle] = at_s
        cluster = self.main.clusters.get(denied_vehicle)
        twin = self.twins.get(denied_vehicle)
        before = self._held.pop(denied_vehicle, None)
        if cluster is None:
            self.twins.pop(denied_vehicle, None)
            return
        self._held[denied_vehicle] = held(cluster, denied_vehicle)
        if twin is None:
            told = self.main.records[denied_vehicle].other_side
            mirror = find_other_side(told, cluster, denied_vehicle, at_s) or find_mirror(cluster, denied_vehicle, at_s)
            if mirror is None and before is not None:
                mirror = find_lost_side(before, cluster, denied_vehicle, at_s)
            if mirror is not None:
                self.main.records.writable(denied_vehicle).other_side = None
                self._begin(denied_vehicle, mirror, at_s)
            return
        other = twin.model.clusters.get(denied_vehicle)
        if other is None:
            del self.twins[denied_vehicle]
            return
        mirror = through_line(cluster, denied_vehicle, at_s)
        sides = Sides.APART if mirror is None else _sides(cluster, other, denied_vehicle, mirror)
        if sides is Sides.APART and not twin.apart:
            # Which side one that was on the line has come to is chance: what told the two apart before told something else.
            twin.forget()
        twin.apart = sides is Sides.APART
        twin.by_motion = told_by_motion(cluster, denied_vehicle, at_s, mirror)
        if sides is Sides.SAME or abs(twin.log_odds) > _DECIDED:
            if twin.log_odds > 0.0:
                self.main.take_over(twin.model, denied_vehicle)
            del self.twins[denied_vehicle]
            if mirror is not None and not twin.apart and _is_aside(self.main.clusters[denied_vehicle], denied_vehicle, mirror):
                # Nobody was on its other side, so that nothing has ruled that out.
                self._begin(denied_vehicle, mirror, at_s)
            return
        x, P = cluster.predicted(denied_vehicle, at_s)
        other_x, other_P = other.predicted(denied_vehicle, at_s)
        d, S = (other_x - x)[:6], (P + other_P)[:6, :6]
        if float(d @ np.linalg.solve(S, d)) < _ONE_AGAIN:
            del self.twins[denied_vehicle]

    def _begin(self, denied_vehicle: int, mirror: Mirror, at_s: float) -> None:
        """Begin a twin in which a denied vehicle is at its mirror image."""
        cluster = self.main.clusters[denied_vehicle]
        by_motion = told_by_motion(cluster, denied_vehicle, at_s, through_line(cluster, denied_vehicle, at_s))
        model = FleetModel(self.main.settings)
        model.take_over(self.main, denied_vehicle)
        reflect(model.clusters[denied_vehicle], denied_vehicle, mirror)
        self.twins[denied_vehicle] = Twin(model, by_motion)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer from the state as it stands: what covers all that is possible, or that it is ambiguous."""
        where = self.main.estimate(vehicle, at_s)
        for twin in self.twins.values():
            if isinstance(where, NoEstimate):
                return where
            if vehicle not in twin.model.clusters:
                continue
            other = twin.model.estimate(vehicle, at_s)
            if isinstance(other, NoEstimate):
                return other
            x = np.concatenate([where.position_enu_m, where.velocity_enu_mps])
            other_x = np.concatenate([other.position_enu_m, other.velocity_enu_mps])
            mean, covariance = blend(x, where.covariance, other_x, other.covariance, twin.log_odds)
            if horizontal_sigma_m(covariance) > self.main.settings.limit_sigma_m:
                apart_m = math.hypot(*(other_x - x)[:2].tolist())
                reason = f"ambiguous: another place, {apart_m:.0f} m from the first, fits the ranges as well"
                return NoEstimate(vehicle, at_s, reason)
            where = Estimate(vehicle, at_s, mean[:3], mean[3:], covariance, where.hdop, where.ranges_in_use)
        return where


def _sides(cluster: Cluster, other: Cluster, denied_vehicle: int, mirror: Mirror) -> Sides:
    away, other_away = away_sigmas(cluster, denied_vehicle, mirror), away_sigmas(other, denied_vehicle, mirror)
    if min(abs(away), abs(other_away)) < _CLEARLY_ASIDE:
        return Sides.OPEN
    return Sides.SAME if away * other_away > 0.0 else Sides.APART


def _is_aside(cluster: Cluster, denied_vehicle: int, mirror: Mirror) -> bool:
    return abs(away_sigmas(cluster, denied_vehicle, mirror)) >= _CLEARLY_ASIDE


def _evidence(main: UpdateResult, twin: UpdateResult) -> float:
    """Return by how much a measurement raises the log odds of the twin: one that neither foresees tells little."""
    if main.degrees_of_freedom == 0 or twin.degrees_of_freedom == 0:
        return 0.0
    gain = 0.5 * (min(main.nis, _MOST_NIS) - min(twin.nis, _MOST_NIS))
    if main.sigma_m > 0.0 and twin.sigma_m > 0.0:
        gain += math.log(main.sigma_m / twin.sigma_m)
    return gain
