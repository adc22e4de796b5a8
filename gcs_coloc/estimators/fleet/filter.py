"""The `fleet` estimator: an extended Kalman filter over each cluster of vehicles.

It uses raw measurements at their own times.

docs/explanation/fleet-filter.md has the equations. This module refuses impossible values and late arrivals, and puts the rest
through the out-of-sequence buffer.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Collection, Mapping
from dataclasses import replace

from gcs_coloc.core.estimator import LossQuery
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    Residual,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome
from gcs_coloc.estimators.fleet.hypotheses import FleetHypotheses
from gcs_coloc.estimators.fleet.loss_prediction import predict_loss
from gcs_coloc.estimators.fleet.out_of_sequence import Entry, Key, OosmBuffer
from gcs_coloc.estimators.fleet.settings import FleetSettings

_RESIDUALS_KEPT = 4096
"""Chosen: bounds the memory when nobody drains; some 30 s of a large fleet."""
_LARGEST = 1e9
"""Chosen: in metres farther than the Moon; squares of what is below it keep their digits."""
_LATEST_S = 3.0  # chosen: radios of real copters held reports back for 0.6 to 3.3 s
_ROUNDING_S = 0.001  # of times in s since 1970, so that what is carried on is within the window
_LATE_ACCELERATION_MPS2 = 3.0  # 1-sigma per axis; chosen: a turn at 17 degrees of bank
_KIND_DENIED, _KIND_CLASS, _KIND_POSITION, _KIND_ALTITUDE, _KIND_ATTITUDE, _KIND_ODOMETRY, _KIND_RANGE = range(7)

_CLASSES = tuple(VehicleClass)
_NO_LEVER_ARM = (0.0, 0.0, 0.0)

Event = Measurement | frozenset[int]


class FleetFilter:
    """The fleet filter; meets `gcs_coloc.core.estimator.Estimator`."""

    name = "fleet"

    def __init__(self, settings: FleetSettings | None = None) -> None:
        self.settings = settings if settings is not None else FleetSettings()
        self._buffer: OosmBuffer[FleetHypotheses, Event] = OosmBuffer(
            FleetHypotheses(self.settings), self._apply, self.settings.window_s
        )
        self._refused: Counter[str] = Counter()
        self._residuals: deque[Residual] = deque(maxlen=_RESIDUALS_KEPT)
        self._now_s = -math.inf
        self._carried_on_s: dict[int, float] = {}
        self._denied_changes = 0
        self._denied: frozenset[int] = frozenset()

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        """Set which vehicles are denied from time `at_s` on."""
        self._denied = frozenset(denied)
        self._advance(at_s)
        self._denied_changes += 1
        # Of two changes at one time the later call wins.
        self._buffer.insert(
            (max(at_s, self._now_s - self.settings.window_s), _KIND_DENIED, self._denied_changes), frozenset(denied)
        )

    def reset(self, vehicle: int, at_s: float) -> None:
        """Initialise a denied vehicle anew from ranges: it is trusted and denied again at one time."""
        denied = self._denied
        self.set_denied(denied - {vehicle}, at_s)
        self.set_denied(denied, at_s)

    def add(self, measurement: Measurement) -> None:
        """Add one measurement; what is not used is counted."""
        late_s = measurement.arrived_at_s - measurement.measured_at_s - self.settings.window_s
        if isinstance(measurement, PositionMeasurement) and 0.0 < late_s <= _LATEST_S:
            # Heard again it would be carried on to another time.
            if measurement.measured_at_s <= self._carried_on_s.get(measurement.vehicle, -math.inf):
                self._refused[Outcome.REFUSED_DUPLICATE] += 1
                return
            self._carried_on_s[measurement.vehicle] = measurement.measured_at_s
            measurement = _carried_on(measurement, late_s + _ROUNDING_S)
        key = _key(measurement)
        if key is None:
            self._refused[Outcome.REFUSED_IMPOSSIBLE] += 1
            return
        self._advance(measurement.arrived_at_s)
        delay_s = measurement.arrived_at_s - measurement.measured_at_s
        if delay_s > self.settings.window_s:
            self._refused[Outcome.REFUSED_TOO_LATE] += 1
        elif delay_s < -self.settings.ahead_s:
            self._refused[Outcome.REFUSED_FUTURE] += 1
        elif not self._buffer.insert(key, measurement):
            self._refused[Outcome.REFUSED_DUPLICATE] += 1

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return where a vehicle is at a time near the present, up to 2 s before its newest measurement."""
        return self._buffer.process().estimate(vehicle, at_s)

    def predict_loss(self, query: LossQuery) -> list[Estimate | NoEstimate]:
        """Predict what would be stated of a healthy vehicle if its GPS failed now.

        See `core.estimator.PredictsLoss`.
        """
        return predict_loss(self._buffer.process().main, query)

    def drain_residuals(self) -> list[Residual]:
        """Return the residuals since the last call, each range once, oldest first."""
        self._buffer.process()
        drained = list(self._residuals)
        self._residuals.clear()
        return drained

    def counts(self) -> Mapping[str, int]:
        """Return the number of measurements by outcome; the keys are members of `Outcome`."""
        self._buffer.process()
        return dict(sorted((self._buffer.outcomes + self._refused).items()))

    def _advance(self, arrived_at_s: float) -> None:
        if arrived_at_s > self._now_s:
            self._now_s = arrived_at_s
            self._buffer.commit(arrived_at_s)

    def _apply(self, model: FleetHypotheses, entry: Entry[Event]) -> str:
        event = entry.event
        if isinstance(event, frozenset):
            model.set_denied(event, entry.key[0])
            return Outcome.DENIED_CHANGED
        result = model.apply(event)
        if isinstance(event, RangeMeasurement) and result.degrees_of_freedom and not entry.reported:
            entry.reported = True
            self._residuals.append(
                Residual(
                    from_vehicle=event.from_vehicle,
                    to_vehicle=event.to_vehicle,
                    measured_at_s=event.measured_at_s,
                    innovation_m=result.innovation_m,
                    sigma_m=result.sigma_m,
                    nis=result.nis,
                    degrees_of_freedom=result.degrees_of_freedom,
                    refused=None if result.used else result.outcome,
                )
            )
        return result.outcome


def _carried_on(m: PositionMeasurement, by_s: float) -> PositionMeasurement:
    """Return a position that arrived after its window where its velocity has led when the window begins.

    A peer whose reports are refused drifts away, and others with it. One without a velocity is returned as it is.
    """
    if m.velocity_enu_mps is None or m.sigma_velocity_mps is None:
        return m
    (e, n, u), (ve, vn, vu) = m.position_enu_m, m.velocity_enu_mps
    faster_mps = _LATE_ACCELERATION_MPS2 * by_s
    led_m = math.hypot(m.sigma_velocity_mps * by_s, 0.5 * faster_mps * by_s)
    return replace(
        m,
        measured_at_s=m.measured_at_s + by_s,
        position_enu_m=(e + ve * by_s, n + vn * by_s, u + vu * by_s),
        sigma_h_m=math.hypot(m.sigma_h_m, led_m),
        sigma_v_m=math.hypot(m.sigma_v_m, led_m),
        sigma_velocity_mps=math.hypot(m.sigma_velocity_mps, faster_mps),
    )


def _key(m: Measurement) -> Key | None:
    """Return the measurement's key: its time, then its content; None where a value is impossible."""
    head: Key
    tail: Key
    if isinstance(m, PositionMeasurement):
        velocity = m.velocity_enu_mps or ()
        sigmas = (m.sigma_h_m, m.sigma_v_m) + ((m.sigma_velocity_mps,) if m.sigma_velocity_mps is not None else ())
        head, tail = (_KIND_POSITION, m.vehicle), (*m.position_enu_m, *velocity, m.time_sigma_s)
    elif isinstance(m, RangeMeasurement):
        if m.range_m < 0.0 or m.from_vehicle == m.to_vehicle:
            return None
        sigmas = (m.sigma_m,)
        head, tail = (_KIND_RANGE, m.from_vehicle, m.to_vehicle, m.device_id), (m.range_m, m.time_sigma_s, m.time_sigma_m)
        if m.offset_enu_m != _NO_LEVER_ARM:
            tail = *tail, *m.offset_enu_m
    elif isinstance(m, AltitudeMeasurement):
        sigmas = (m.sigma_m,)
        head, tail = (_KIND_ALTITUDE, m.vehicle), (m.up_m,)
    elif isinstance(m, AttitudeMeasurement):
        sigmas = (1.0,)
        air = (m.airspeed_mps,) if m.airspeed_mps is not None else ()
        head, tail = (_KIND_ATTITUDE, m.vehicle), (m.roll_rad, m.pitch_rad, m.yaw_rad, *air)
    elif isinstance(m, OdometryMeasurement):
        sigmas = (m.sigma_velocity_mps, m.sigma_turn_radps)
        head, tail = (_KIND_ODOMETRY, m.vehicle), (m.forward_mps, m.right_mps, m.turn_radps)
    elif isinstance(m, VehicleClassReport):
        sigmas = (1.0,)
        head, tail = (_KIND_CLASS, m.vehicle), (_CLASSES.index(m.vehicle_class),)
    else:
        return None
    numbers = *tail, *sigmas
    if min(sigmas) <= 0.0 or not all(abs(number) < _LARGEST for number in numbers):
        return None
    return (m.measured_at_s, *head, *numbers) if math.isfinite(m.measured_at_s) and math.isfinite(m.arrived_at_s) else None
