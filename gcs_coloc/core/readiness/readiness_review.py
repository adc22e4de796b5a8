"""The review of readiness: one healthy vehicle after the other, so that no poll takes long.

It observes: no estimate, no state of GPS and no message depends on it.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import hypot, inf

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.estimator import GuardedEstimator, LossQuery
from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch
from gcs_coloc.core.integrity.fix_check import star
from gcs_coloc.core.integrity.protection_level import Exposure, ProtectionSettings
from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.core.readiness.held_motion import TurnRate
from gcs_coloc.core.readiness.loss_forecast import EarlierPrediction, LossSituation, forecast
from gcs_coloc.core.readiness.vehicle_readiness import HORIZON_S, Limit, LimitingReason, ReadinessState, VehicleReadiness
from gcs_coloc.core.schedule import SAME_S
from gcs_coloc.core.telemetry.reported_state import ReportedState

EVERY_S = 10.0
"""Each vehicle is predicted so often. Chosen: geometry changes little in 10 s."""
_SPACING_S = 0.8
"""Least time between two predictions, of any vehicles. Chosen: four reviews, so that each of 30 has its turn within
24 s; with 15 ms each they take 2 % of a core."""
_CONFIRMED_AFTER_S = 2.0  # a change of state counts after so long; chosen: two predictions that agree
_RECOVERED_AFTER_S = 20.0
"""The same where readiness was lost in flight. Chosen: the alarm does not come and go at the edge of a limit."""
_KEPT_S, _SPAN_S = 65.0, 45.0
"""Predictions are kept so long, and are those of the last minute once they span so long. Chosen: a minute of predictions every
10 s, and every 24 s in a fleet of 30."""
_BEGUN_AFTER_S = 5.0  # a vehicle is predicted from so long after it was first heard; chosen: its ranges are heard by then
_TURNS_EVERY_S = 1.0
"""Velocities for turn rates are taken so often. Chosen: a plane turns by 12 degrees in a second, never by half a circle."""
_FLYING_SPEED_MPS = 3.0  # chosen: faster than a vehicle at rest seems to be, slower than any flight but a hover
_FLYING_HEIGHT_M = 5.0  # over where it was armed; chosen: beyond the drift of a barometer on the ground
_RANGES_KEPT_S = 10.0  # chosen: two ranges of a pair at 0.2 Hz, the slowest that the fleet filter selects a peer by
_MOST_RANGES = 600  # ranges of one vehicle; chosen: 10 s of six peers at 10 Hz; of more the last seconds tell the rates as well


class RecentRanges:
    """The last seconds' ranges by vehicle at either end, as the estimator got them, oldest first."""

    def __init__(self) -> None:
        self._of: defaultdict[int, deque[RangeMeasurement]] = defaultdict(partial(deque, maxlen=_MOST_RANGES))

    def forget(self, vehicle: int) -> None:
        """Forget the ranges of a vehicle."""
        self._of.pop(vehicle, None)

    def add(self, measurement: RangeMeasurement) -> None:
        """Add a range."""
        for end in measurement.ends:
            if end > 0:
                self._of[end].append(measurement)

    def of(self, vehicle: int, now_s: float) -> list[RangeMeasurement]:
        """Return the ranges of a vehicle that were measured within the last 10 s."""
        oldest_s = now_s - _RANGES_KEPT_S
        return [m for m in self._of.get(vehicle, ()) if m.measured_at_s >= oldest_s]


@dataclass(frozen=True, slots=True)
class ReadinessInputs:
    """What earlier stages know of a vehicle for the prediction of its loss."""

    ranges: Sequence[RangeMeasurement]
    """Its ranges of late."""
    epoch: Epoch
    """The residuals of the last review of integrity."""
    stated_epoch: Epoch
    """The same with their noise as stated."""
    node: Callable[[int], PositionMeasurement | None]
    """Returns where the other end of a range reports to be, None where that is no evidence."""
    exposure: Exposure
    height_sigma_m: float
    """1-sigma of the heights that it would have without GPS."""
    not_aided: str | None
    """Why it would get no aid."""


@dataclass(slots=True)
class _Followed:
    """What is known of one vehicle from earlier predictions.

    `stated` is the readiness that is stated. `other_since_s` is since when predictions have had another state. `predictions` are
    those of the last minute, with their times.
    """

    stated: VehicleReadiness
    predicted_at_s: float
    predictions: deque[tuple[float, EarlierPrediction | None]] = field(default_factory=deque)
    other: ReadinessState | None = None
    other_since_s: float = 0.0

    def add(self, found: VehicleReadiness) -> None:
        """Add a prediction."""
        hdop, bound_m = found.hdop_now, found.bound_95_m
        earlier = EarlierPrediction(hdop, bound_m) if hdop is not None and bound_m is not None else None
        self.predictions.append((found.at_s, earlier))
        while found.at_s - self.predictions[0][0] > _KEPT_S:
            self.predictions.popleft()

    def recent(self, at_s: float) -> list[EarlierPrediction]:
        """Return the predictions of the last minute.

        The list is empty where the vehicle was not followed for so long, or was not always located in them.
        """
        known = [earlier for _, earlier in self.predictions if earlier is not None]
        spans = len(known) > 0 and at_s - self.predictions[0][0] >= _SPAN_S
        return known if spans and len(known) == len(self.predictions) else []

    @property
    def due_s(self) -> float:
        """When it is to be predicted again."""
        return self.predicted_at_s + (EVERY_S if self.other is None else _CONFIRMED_AFTER_S)


@dataclass(slots=True)
class _Sortie:
    """One sortie of a vehicle, from when it was armed.

    `armed_alt_m` is its altitude at that time. `is_flying`: it has left the ground. `was_located`: it would have been located
    without GPS, at some time of the sortie.
    """

    armed_alt_m: float
    is_flying: bool = False
    was_located: bool = False


@dataclass(slots=True)
class _Vehicle:
    """What is kept of one vehicle: `followed` while its GPS is healthy, a `sortie` while it is armed."""

    followed: _Followed | None = None
    sortie: _Sortie | None = None
    turns: TurnRate = field(default_factory=TurnRate)


class ReadinessReview:
    """The readiness of all healthy vehicles of a fleet, kept up to date by `due` and `review`."""

    def __init__(self, estimator: GuardedEstimator, aiding: AidingSettings, protection: ProtectionSettings) -> None:
        self._estimator = estimator
        self._aiding, self._protection = aiding, protection
        self._vehicles: defaultdict[int, _Vehicle] = defaultdict(_Vehicle)
        self._predicted_at_s = -inf
        self._turns_at_s = -inf

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one."""
        self._vehicles.pop(sysid, None)

    def of(self, sysid: int) -> VehicleReadiness | None:
        """Return the readiness of a vehicle; None while its GPS is not healthy, and until it was predicted."""
        kept = self._vehicles.get(sysid)
        return kept.followed.stated if kept is not None and kept.followed is not None else None

    def due(self, vehicles: Iterable[ReportedState], is_healthy: Callable[[int], bool], now_s: float) -> ReportedState | None:
        """Return the vehicle to be predicted now, None where there is none; forget those that are not healthy."""
        first, first_due_s = None, inf
        are_turns_due = now_s - self._turns_at_s >= _TURNS_EVERY_S - SAME_S
        if are_turns_due:
            self._turns_at_s = now_s
        for vehicle in vehicles:
            kept = self._vehicles[vehicle.sysid]
            kept.sortie = _sortie(kept.sortie, vehicle)
            if are_turns_due and vehicle.position is not None:
                kept.turns.add(now_s, vehicle.position.ve_mps, vehicle.position.vn_mps)
            if not is_healthy(vehicle.sysid):
                kept.followed = None
                continue
            due_s = kept.followed.due_s if kept.followed is not None else vehicle.first_heard_s + _BEGUN_AFTER_S
            if first is None or due_s < first_due_s:
                first, first_due_s = vehicle, due_s
        return first if first_due_s <= now_s and now_s - self._predicted_at_s >= _SPACING_S - SAME_S else None

    def review(self, vehicle: ReportedState, now_s: float, inputs: ReadinessInputs) -> None:
        """Predict one vehicle by its ranges of late."""
        self._predicted_at_s = now_s
        found = self._predict(vehicle.sysid, now_s, inputs)
        if inputs.not_aided is not None and found.state is not ReadinessState.UNKNOWN:
            limit = Limit(LimitingReason.NOT_AIDED, detail=inputs.not_aided)
            found.state, found.reason, found.text = ReadinessState.NOT_READY, limit.reason.code, limit.text
        kept = self._vehicles[vehicle.sysid]
        kept.followed = _followed(kept.followed, found, now_s)
        now, sortie = kept.followed.stated, kept.sortie
        if sortie is not None:
            sortie.was_located |= now.state in (ReadinessState.READY, ReadinessState.DEGRADED)
            now.is_lost = sortie.is_flying and sortie.was_located and now.state is ReadinessState.NOT_READY

    def _predict(self, sysid: int, now_s: float, inputs: ReadinessInputs) -> VehicleReadiness:
        ranges, node, epoch = inputs.ranges, inputs.node, inputs.epoch
        others = {m.other_end(sysid) for m in ranges}
        peers = {other: reported for other in sorted(others) if (reported := node(other)) is not None}
        used = [m for m in ranges if m.to_vehicle in peers or m.from_vehicle in peers]
        turns_radps = {node: self._vehicles[node].turns.radps for node in (sysid, *peers) if node in self._vehicles}
        query = LossQuery(sysid, now_s, HORIZON_S, used, turns_radps, inputs.height_sigma_m)
        answers = self._estimator.predict_loss(query)
        if answers is None:
            limit = Limit(LimitingReason.NOT_PREDICTED, detail=self._estimator.name)
            return VehicleReadiness(ReadinessState.UNKNOWN, now_s, limit.reason.code, limit.text, len(peers))
        # Those of one time are one: they show the motion together.
        span_s = now_s - used[0].measured_at_s if used else inf
        interval_s = span_s / len({m.measured_at_s for m in used}) if used else inf
        around = _without_values(star(epoch, sysid, peers))
        as_stated = around if inputs.stated_epoch is epoch else _without_values(star(inputs.stated_epoch, sysid, peers))
        own = node(sysid)
        velocity = own.velocity_enu_mps if own is not None else None
        followed = self._vehicles[sysid].followed
        recent = followed.recent(now_s) if followed is not None else []
        situation = LossSituation(
            sysid,
            velocity or (0.0, 0.0, 0.0),
            peers,
            around,
            as_stated,
            turns_radps,
            interval_s,
            len(used) / max(span_s, 1.0),
            inputs.exposure,
            recent,
        )
        return forecast(situation, answers, self._aiding, self._protection)


def _followed(followed: _Followed | None, found: VehicleReadiness, now_s: float) -> _Followed:
    """Return what is stated after a prediction: a change of state only once it has lasted."""
    if followed is None:
        followed = _Followed(found, now_s)
    followed.predicted_at_s = now_s
    followed.add(found)
    if found.state is followed.stated.state:
        followed.stated, followed.other = found, None
        return followed
    if followed.other is not found.state:
        followed.other, followed.other_since_s = found.state, now_s
    lasts_s = _RECOVERED_AFTER_S if followed.stated.is_lost else _CONFIRMED_AFTER_S
    if now_s - followed.other_since_s >= lasts_s - SAME_S:
        followed.stated, followed.other = found, None
    return followed


def _sortie(sortie: _Sortie | None, vehicle: ReportedState) -> _Sortie | None:
    """Return the sortie that a vehicle is on, brought up to date; None while it is not armed."""
    position = vehicle.position
    if not vehicle.armed or position is None:
        return None
    sortie = sortie if sortie is not None else _Sortie(position.alt_msl_m)
    is_fast = hypot(position.vn_mps, position.ve_mps) >= _FLYING_SPEED_MPS
    sortie.is_flying |= is_fast or abs(position.alt_msl_m - sortie.armed_alt_m) >= _FLYING_HEIGHT_M
    return sortie


def _without_values(epoch: Epoch) -> Epoch:
    """Return an epoch as it is expected to be: every residual is zero."""
    return replace(epoch, residuals=tuple(residual._replace(residual_m=0.0) for residual in epoch.residuals))
