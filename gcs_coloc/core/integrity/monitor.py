"""The integrity stage of one fleet: reported positions, ranges and estimates in, one `IntegrityReport` out.

A vehicle that is healthy or suspect has its reported position as a prior. One whose GPS has failed has none: its autopilot
echoes our fix, so it stands where the estimator has it, free to move horizontally. An identified vehicle is readmitted only
after its real receiver has agreed for a while with where the ranges put it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.range_consistency import ConsistencySettings, RangeConsistency
from gcs_coloc.core.integrity.range_residuals import TrackPoint
from gcs_coloc.core.integrity.reacquisition import ReacquisitionMonitor
from gcs_coloc.core.integrity.report import FaultReason, IntegrityReport, PositionFault, ReviewedVehicle
from gcs_coloc.core.measurements import FloatArray, PositionMeasurement, RangeMeasurement

PLACED_BY_ESTIMATE = (GpsState.FAILED, GpsState.RECOVERING)
"""The states in which the review needs the estimator's answer for a vehicle."""
_PLACED_BY_REPORT = (GpsState.HEALTHY, GpsState.SUSPECT)
_LARGEST_SIGMA_V_M = 10.0  # chosen: a free height would cost each range its information
_LONGEST_FIX_LATENCY_S = 0.5  # of GNSS receivers without configured delay; PX4 EKF2_GPS_DELAY is at most 0.3 s
_LEAST_SPEED_MPS = 1.0  # below it a course says nothing
_AGREES_SIGMAS = 3.0  # 99.7 % of a Gaussian
_AGREES_FOR_S = 5.0  # chosen: GPS health watches it for 10 s more, in which it is no witness and the ranges test it
_WELL_KNOWN_SHARE = 0.25  # of the fault's size; chosen: four sigmas tell the fault from none
_OLDEST_FIX_S = 1.0  # of a receiver at 1 Hz


class IntegrityMonitor:
    """Detects, isolates and bounds faults of reported positions. Call `review` several times a second."""

    def __init__(self, settings: ConsistencySettings | None = None) -> None:
        self._consistency = RangeConsistency(settings)
        self._reacquisition = ReacquisitionMonitor(self._consistency.settings)
        self._agreements: dict[int, tuple[float, FloatArray]] = {}

    def add_position(self, position: PositionMeasurement, gps_state: GpsState, *, is_aided: bool) -> None:
        """Add the position that a vehicle reports; one that is aided, or has no GPS, reports nothing of its own."""
        if gps_state not in _PLACED_BY_REPORT or is_aided or position.velocity_enu_mps is None:
            return
        track = TrackPoint(
            position.measured_at_s,
            position.position_enu_m,
            position.velocity_enu_mps,
            position.sigma_h_m,
            position.sigma_v_m,
            no_prior=False,
        )
        self._consistency.add_position(position.vehicle, track)

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Add a range between two vehicles."""
        self._consistency.add_range(measurement)
        self._reacquisition.add_range(measurement)

    def review(self, now_s: float, vehicles: Sequence[ReviewedVehicle], frame: LocalFrame | None) -> IntegrityReport:
        """Test what was added up to now (service time, s). Without a frame there is no position to test."""
        if frame is None:
            return IntegrityReport()
        for vehicle in vehicles:
            if vehicle.gps_state in PLACED_BY_ESTIMATE:
                where = vehicle.estimate
                if where is not None:
                    sigma_v_m = min(sqrt(float(where.covariance[2, 2])), _LARGEST_SIGMA_V_M)
                    (e, n, u), (ve, vn, vu) = where.position_enu_m.tolist(), where.velocity_enu_mps.tolist()
                    track = TrackPoint(now_s, (e, n, u), (ve, vn, vu), 0.0, sigma_v_m, no_prior=True)
                    self._consistency.add_position(vehicle.sysid, track)
                if vehicle.sysid in self._consistency.identified and self._receiver_agrees(vehicle, frame, now_s):
                    self._consistency.readmit(vehicle.sysid)
        self._consistency.review(now_s)
        tested = IntegrityReport(separation_m2=dict(self._consistency.separation_m2))
        inflated = [replace(v, estimate=tested.inflate(v.estimate)) if v.estimate is not None else v for v in vehicles]
        reacquired = self._reacquisition.review(now_s, inflated)
        sysids = [vehicle.sysid for vehicle in vehicles]
        faults = {sysid: fault for sysid in sysids if (fault := self._fault(sysid)) is not None}
        return replace(reacquired, faults={**reacquired.faults, **faults}, separation_m2=tested.separation_m2)

    def _fault(self, sysid: int) -> PositionFault | None:
        identified = self._consistency.identified.get(sysid)
        if identified is not None:
            return PositionFault(FaultReason.CONTRADICTS_RANGES, identified.size_m, identified.peers)
        if sysid in self._consistency.detected:
            return PositionFault(FaultReason.NOT_ISOLATED, others=tuple(sorted(self._consistency.detected - {sysid})))
        return None

    def _receiver_agrees(self, vehicle: ReviewedVehicle, frame: LocalFrame, now_s: float) -> bool:
        """Whether the real receiver has agreed for a while with an estimate that is accurate enough to tell."""
        fix, where, fault = vehicle.receiver, vehicle.estimate, self._consistency.identified[vehicle.sysid]
        if fix is None or fix.fix_type < 3 or where is None or now_s - fix.received_at_s > _OLDEST_FIX_S:
            self._agreements.pop(vehicle.sysid, None)
            return False
        reported_m = np.array(frame.enu_from_geodetic(fix.lat_deg, fix.lon_deg, fix.alt_msl_m)[:2])
        age_s, velocity = now_s - fix.received_at_s, where.velocity_enu_mps[:2]
        off_m = _beyond_latency(reported_m - (where.position_enu_m[:2] - velocity * age_s), velocity)
        known_m = horizontal_sigma_m(where.covariance)
        sigma_m = hypot(known_m, fix.h_acc_m if fix.h_acc_m is not None else 5.0)
        since_s, first_m = self._agreements.setdefault(vehicle.sysid, (now_s, off_m))
        # An estimate that is less certain than the fault was large agrees with anything.
        if float(np.hypot(*off_m)) > _AGREES_SIGMAS * sigma_m or known_m > _WELL_KNOWN_SHARE * fault.size_m:
            self._agreements.pop(vehicle.sysid)
            return False
        if float(np.hypot(*(off_m - first_m))) > _AGREES_SIGMAS * sigma_m:
            # The reported position passes the true one and goes on.
            self._agreements[vehicle.sysid] = (now_s, off_m)
            return False
        if now_s - since_s < _AGREES_FOR_S:
            return False
        del self._agreements[vehicle.sysid]
        return True


def _beyond_latency(difference_m: FloatArray, velocity_mps: FloatArray) -> FloatArray:
    """What a receiver's latency leaves of the difference by which its fix is off (east, north)."""
    speed_mps = float(np.hypot(*velocity_mps))
    along = velocity_mps / speed_mps if speed_mps > _LEAST_SPEED_MPS else np.zeros(2)
    behind_m = min(max(-float(difference_m @ along), 0.0), speed_mps * _LONGEST_FIX_LATENCY_S)
    off_m: FloatArray = difference_m + behind_m * along
    return off_m
