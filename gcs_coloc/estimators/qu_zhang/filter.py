"""The estimator of Qu & Zhang (AIAA 2010-8187) for live, asynchronous measurements.

Each vehicle has a constant-velocity Kalman filter. The ranges of a denied vehicle to three peers give a position in
closed form (Eq. 16-22), and that fix is the observation of the vehicle's own filter (Eq. 27-31), with a covariance that follows
the geometry (Eq. 23-26, 32).

What the paper leaves out and flying needs: ranges of one epoch measured at different instants are brought together by shifting
each circle with the vehicle's predicted displacement; heights turn slant ranges into horizontal ones; of more than three peers
the best three that agree are used; fixes are gated; and the errors of the peers, which last for minutes where the filter takes
them as new every time, are carried beside the filter so that the stated covariance does not average them away.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Collection, Mapping
from enum import StrEnum

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    FloatArray,
    Measurement,
    NoEstimate,
    NoEstimateReason,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    Residual,
    Unlocated,
    VehicleClassReport,
    is_possible,
)
from gcs_coloc.estimators.qu_zhang.cv_filter import CvFilter, density, position_rows
from gcs_coloc.estimators.qu_zhang.denied_vehicle import (
    CONFIRMATIONS,
    DeniedVehicleFilter,
    RangeEpoch,
    RangeEpochGatherer,
    lasting_covariance,
)
from gcs_coloc.estimators.qu_zhang.fix import Fix, circles_of, fix_of
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings
from gcs_coloc.estimators.qu_zhang.track import NisGate, PeerTrack
from gcs_coloc.estimators.qu_zhang.trilateration import range_residual


class QuZhangOutcome(StrEnum):
    """What became of a measurement or an epoch: the keys of `counts()` and the labels of the metric."""

    NO_CLASS = "vehicle class not used by this estimator"
    NO_ATTITUDE = "attitude not used by this estimator"
    NO_ODOMETRY = "odometry not used by this estimator"
    REFUSED_IMPOSSIBLE = "impossible value"
    REFUSED_FUTURE = "measured in the future"
    REFUSED_TOO_LATE = "too late"
    REFUSED_DENIED_POSITION = "position of a vehicle without GPS"
    POSITION_USED = "position used"
    REFUSED_POSITION_GATE = "position refused by the gate"
    ALTITUDE_NOT_NEEDED = "altitude of a vehicle with GPS"
    ALTITUDE_USED = "altitude used"
    REFUSED_ALTITUDE_GATE = "altitude refused by the gate"
    RANGE_BOTH_GPS = "range between vehicles with GPS"
    RANGE_BOTH_DENIED = "range between vehicles without GPS"
    RANGE_PEER_NOT_FRESH = "range to a peer without a fresh position"
    FIX_USED = "fix used"
    EPOCH_WITHOUT_FIX = "epoch without a fix"
    FIX_REFUSED = "fix refused"
    RANGE_USED = "range used"
    RANGE_NOT_USED = "range not used"


PAPER_STEP_S = 0.02
"""The paper's computing cycle, to which its q belongs (it prints 0.02 ms, which only 50 Hz makes sense of)."""

_IN_USE_S = 2.0  # ranges count as in use for this long after their fix; chosen: two epochs at 1 Hz

_RESIDUALS_KEPT = 2000  # chosen: bounds the memory where nobody drains them; those of a minute of eight peers at 4 Hz


class QuZhangFilter:
    """The estimator of Qu & Zhang (2010) for live measurements.

    Meets `gcs_coloc.core.estimator.Estimator`.
    """

    def __init__(self, settings: QuZhangSettings | None = None) -> None:
        self._settings = settings or QuZhangSettings()
        self._tracks: dict[int, PeerTrack] = {}
        self._denied: dict[int, DeniedVehicleFilter] = {}
        self._former: dict[int, DeniedVehicleFilter] = {}
        self._residuals: deque[Residual] = deque(maxlen=_RESIDUALS_KEPT)
        self._counts: Counter[str] = Counter()

    @property
    def name(self) -> str:
        """The name that the configuration chooses it by."""
        return "qu_zhang"

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        """State which vehicles are to be located from ranges from `at_s` on."""
        for vehicle in set(self._denied) - set(denied):
            # Its state came from ranges; the first position from its own receiver begins a new track.
            self._former[vehicle] = self._denied.pop(vehicle)
        for vehicle in sorted(set(denied) - set(self._denied)):
            former = vehicle in self._former
            self._denied[vehicle] = self._former.pop(vehicle) if former else self._new_denied_vehicle(vehicle, at_s)

    def reset(self, vehicle: int, at_s: float) -> None:
        """As the protocol says; nothing to do, as each epoch is located from ranges alone."""

    def add(self, measurement: Measurement) -> None:
        """Add one measurement; never raises for its values."""
        for vehicle, denied_vehicle in self._denied.items():
            for epoch in denied_vehicle.gatherer.pop_due(measurement.arrived_at_s):
                self._close(vehicle, denied_vehicle, epoch)
        if isinstance(measurement, VehicleClassReport):
            self._counts[QuZhangOutcome.NO_CLASS] += 1
        elif not is_possible(measurement):
            self._counts[QuZhangOutcome.REFUSED_IMPOSSIBLE] += 1
        elif measurement.measured_at_s > measurement.arrived_at_s + self._settings.late_window_s:
            # One such time would carry a filter into the future and make everything after it late.
            self._counts[QuZhangOutcome.REFUSED_FUTURE] += 1
        elif isinstance(measurement, RangeMeasurement):
            self._add_range(measurement)
        elif isinstance(measurement, PositionMeasurement):
            self._add_position(measurement)
        elif isinstance(measurement, AltitudeMeasurement):
            self._add_altitude(measurement)
        elif isinstance(measurement, AttitudeMeasurement):
            self._counts[QuZhangOutcome.NO_ATTITUDE] += 1
        elif isinstance(measurement, OdometryMeasurement):
            self._counts[QuZhangOutcome.NO_ODOMETRY] += 1

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer where a vehicle is at a time near the present, by prediction from its filters."""
        track = self._tracks.get(vehicle)
        denied_vehicle = self._denied.get(vehicle) or self._former.get(vehicle)
        reason = self._no_estimate_reason(track, denied_vehicle, at_s)
        if reason is not None or track is None or track.horizontal is None or track.vertical is None:
            return NoEstimate(vehicle, at_s, reason or Unlocated(NoEstimateReason.NOT_LOCATED))
        state, _ = track.horizontal.predicted(at_s)
        covariance = self._covariance(track, track.horizontal, denied_vehicle, at_s)
        vertical_state, vertical_covariance = track.vertical.predicted(at_s)
        vertical_covariance[0, 0] += track.sigma_v_m**2
        sigma_m = horizontal_sigma_m(covariance[np.ix_([0, 2], [0, 2])])
        if sigma_m > self._settings.max_sigma_m:
            cause = denied_vehicle.cause if denied_vehicle is not None else ""
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.TOO_UNCERTAIN, sigma_m, detail=cause))
        full = np.zeros((6, 6))
        # [e, ve, n, vn] and [u, vu] to [e, n, u, ve, vn, vu].
        full[np.ix_([0, 3, 1, 4], [0, 3, 1, 4])] = covariance
        full[np.ix_([2, 5], [2, 5])] = vertical_covariance
        fresh = denied_vehicle is not None and at_s - denied_vehicle.last_fix_s <= _IN_USE_S
        return Estimate(
            vehicle=vehicle,
            at_s=at_s,
            position_enu_m=np.array([state[0], state[2], vertical_state[0]]),
            velocity_enu_mps=np.array([state[1], state[3], vertical_state[1]]),
            covariance=0.5 * (full + full.T),
            hdop=denied_vehicle.hdop if denied_vehicle is not None and fresh and math.isfinite(denied_vehicle.hdop) else None,
            ranges_in_use=len(denied_vehicle.peers) if denied_vehicle is not None and fresh else 0,
        )

    def drain_residuals(self) -> list[Residual]:
        """Return the residuals of fixes and of their ranges since the last call, oldest first."""
        taken = list(self._residuals)
        self._residuals.clear()
        return taken

    def counts(self) -> Mapping[str, int]:
        """Return the number of measurements and epochs by outcome, in words."""
        return dict(self._counts)

    def _new_denied_vehicle(self, vehicle: int, at_s: float) -> DeniedVehicleFilter:
        settings = self._settings
        denied_vehicle = DeniedVehicleFilter(
            RangeEpochGatherer(settings.epoch_window_s, settings.epoch_wait_s),
            NisGate(settings.gate_probability, settings.gate_patience),
        )
        track = self._tracks.get(vehicle)
        fresh = track is not None and track.position_age_s(at_s) <= settings.max_prediction_s
        if track is not None and track.horizontal is not None and fresh:
            # Its receiver's lasting error stays in the state that the ranges take over.
            track.horizontal.add_position_variance(track.sigma_h_m**2)
            denied_vehicle.last_fix_s = track.position_at_s
            denied_vehicle.confirmations = CONFIRMATIONS
        elif track is not None:
            track.horizontal = None
        return denied_vehicle

    def _track(self, vehicle: int) -> PeerTrack:
        settings = self._settings
        if vehicle not in self._tracks:
            self._tracks[vehicle] = PeerTrack(
                density(settings.q_m2ps2, PAPER_STEP_S),
                density(settings.q_vertical_m2ps2, PAPER_STEP_S),
                settings.gate_probability,
                settings.gate_patience,
                settings.late_window_s,
            )
        return self._tracks[vehicle]

    def _is_late(self, one: CvFilter | None, measured_at_s: float) -> bool:
        if one is None or not one.is_too_late(measured_at_s):
            return False
        self._counts[QuZhangOutcome.REFUSED_TOO_LATE] += 1
        return True

    def _add_position(self, measurement: PositionMeasurement) -> None:
        vehicle = measurement.vehicle
        if vehicle in self._denied:
            self._counts[QuZhangOutcome.REFUSED_DENIED_POSITION] += 1
            return
        track = self._track(vehicle)
        if vehicle in self._former or track.position_age_s(measurement.measured_at_s) > self._settings.max_prediction_s:
            self._former.pop(vehicle, None)
            track.start(measurement)
            self._counts[QuZhangOutcome.POSITION_USED] += 1
        elif not self._is_late(track.horizontal, measurement.measured_at_s):
            self._counts[
                QuZhangOutcome.POSITION_USED if track.add_position(measurement) else QuZhangOutcome.REFUSED_POSITION_GATE
            ] += 1

    def _add_altitude(self, measurement: AltitudeMeasurement) -> None:
        if measurement.vehicle not in self._denied:
            # A vehicle with GPS states its height with its position.
            self._counts[QuZhangOutcome.ALTITUDE_NOT_NEEDED] += 1
            return
        track = self._track(measurement.vehicle)
        if not self._is_late(track.vertical, measurement.measured_at_s):
            self._counts[
                QuZhangOutcome.ALTITUDE_USED if track.add_altitude(measurement) else QuZhangOutcome.REFUSED_ALTITUDE_GATE
            ] += 1

    def _add_range(self, measurement: RangeMeasurement) -> None:
        ends = measurement.ends
        located = [(own, peer) for own, peer in (ends, ends[::-1]) if own in self._denied]
        if not located:
            self._counts[QuZhangOutcome.RANGE_BOTH_GPS] += 1
        elif len(located) == 2:
            # A fix from another fix would count the same peers' errors twice.
            self._counts[QuZhangOutcome.RANGE_BOTH_DENIED] += 1
        else:
            [(vehicle, peer)] = located
            denied_vehicle = self._denied[vehicle]
            epoch = denied_vehicle.gatherer.add(peer, measurement)
            if epoch is not None:
                self._close(vehicle, denied_vehicle, epoch)

    def _close(self, vehicle: int, denied_vehicle: DeniedVehicleFilter, epoch: RangeEpoch) -> None:
        """Make a fix of an epoch's ranges and update the vehicle's filter, or record the reason why not."""
        track, at_s = self._track(vehicle), epoch.newest_s
        if at_s - denied_vehicle.last_fix_s > self._settings.max_prediction_s:
            # So wide a gate passes any fix: initialise again, with fixes that must agree.
            track.horizontal = None
        if self._is_late(track.horizontal, at_s):
            return
        peers = {peer: one for peer, one in self._tracks.items() if peer not in self._former and peer not in self._denied}
        circles, reasons = circles_of(epoch.ranges, track, peers, at_s, self._settings)
        self._counts[QuZhangOutcome.RANGE_PEER_NOT_FRESH] += len(reasons)
        predicted: tuple[FloatArray, FloatArray] | None = None
        expected: tuple[FloatArray, FloatArray] | None = None
        if track.horizontal is not None:
            predicted = track.horizontal.predicted(at_s)
            covariance = self._covariance(track, track.horizontal, denied_vehicle, at_s)
            expected = predicted[0][[0, 2]], covariance[np.ix_([0, 2], [0, 2])]
        solution = fix_of(vehicle, track, circles, expected, at_s, self._settings)
        fix: Fix | None = None
        if isinstance(solution, str):
            refused: str | None = "; ".join([solution, *reasons])
        else:
            fix, refused = solution, self._apply_fix(vehicle, track, denied_vehicle, solution, at_s)
        denied_vehicle.reason = refused
        not_used = QuZhangOutcome.EPOCH_WITHOUT_FIX if fix is None else QuZhangOutcome.FIX_REFUSED
        self._counts[QuZhangOutcome.FIX_USED if refused is None else not_used] += 1
        height_m2 = track.height_variance_m2(at_s)
        for one in circles:
            chosen = fix is not None and one.peer in fix.peers
            result = refused if chosen or fix is None else "not among the three of the fix"
            self._counts[QuZhangOutcome.RANGE_USED if result is None else QuZhangOutcome.RANGE_NOT_USED] += 1
            if predicted is not None:
                measured_at_s = epoch.ranges[one.peer].measured_at_s
                self._residuals.append(range_residual(vehicle, one, predicted, height_m2, measured_at_s, result))

    def _apply_fix(
        self, vehicle: int, track: PeerTrack, denied_vehicle: DeniedVehicleFilter, fix: Fix, at_s: float
    ) -> str | None:
        """Update or initialise the filter with a fix; return the reason if it is refused, else None."""
        if track.horizontal is None:
            if (
                horizontal_sigma_m(fix.covariance + lasting_covariance(fix.sensitivities, fix.lasting, 2))
                > self._settings.max_sigma_m
            ):
                return "the geometry is too poor to start from"
            track.start_horizontal(at_s, fix.position_m, fix.covariance, sensitivities=fix.sensitivities)
            denied_vehicle.start(fix, at_s)
            return None
        nis, innovation_m, sigma_m = denied_vehicle.test_fix(track.horizontal, fix, at_s)
        result = denied_vehicle.gate.test(nis, 2)
        refused = None if result.accepted else f"the fix is {innovation_m:.0f} m from the prediction (NIS {nis:.0f})"
        if result.accepted:
            track.horizontal.update(fix.position_m, fix.covariance, position_rows(2), at_s, fix.sensitivities)
            denied_vehicle.accept(fix, at_s)
        elif result.inflation > 1.0:
            track.horizontal.inflate_covariance(result.inflation)
        self._residuals.append(Residual(vehicle, None, at_s, innovation_m, sigma_m, nis, 2, refused))
        return refused

    def _covariance(
        self, track: PeerTrack, horizontal: CvFilter, denied_vehicle: DeniedVehicleFilter | None, at_s: float
    ) -> FloatArray:
        """Return the covariance (4, 4) of the horizontal state at a time, lasting errors included."""
        if denied_vehicle is not None:
            return denied_vehicle.covariance(horizontal, at_s)
        covariance = horizontal.predicted(at_s)[1]
        if self._settings.lasting_peer_errors:
            covariance[[0, 2], [0, 2]] += track.sigma_h_m**2
        return covariance

    def _no_estimate_reason(
        self, track: PeerTrack | None, denied_vehicle: DeniedVehicleFilter | None, at_s: float
    ) -> Unlocated | None:
        if denied_vehicle is not None:
            return denied_vehicle.no_estimate_reason(track, at_s, self._settings.max_prediction_s)
        if track is None or track.horizontal is None:
            return Unlocated(NoEstimateReason.NOT_LOCATED)
        age_s = track.position_age_s(at_s)
        return Unlocated(NoEstimateReason.STALE, age_s) if age_s > self._settings.max_prediction_s else None
