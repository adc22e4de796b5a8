"""Consistency of the fleet's GPS with its ranges, between the engine's records and the test: who claims what, who has lied.

A vehicle that is trusted or suspected claims what its autopilot reports. One that has failed claims nothing: its autopilot
echoes our aid, so it is placed where the estimator has it, and the test takes that place as free. An accused one is
believed again only after its real receiver has agreed for a while with where the ranges put it.
"""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import Contradiction, GpsState
from gcs_coloc.core.integrity.range_consistency import ConsistencySettings, RangeConsistency
from gcs_coloc.core.integrity.range_residuals import ReportedTrack
from gcs_coloc.core.integrity.reacquisition import Answer, ReacquisitionMonitor
from gcs_coloc.core.measurements import Estimate, FloatArray, NoEstimate, PositionMeasurement, RangeMeasurement
from gcs_coloc.core.telemetry.vehicles import Vehicle, VehicleRegistry

_CLAIMS_IN = (GpsState.HEALTHY, GpsState.SUSPECT)
_PLACED_IN = (GpsState.FAILED, GpsState.RECOVERING)
_SIGMA_V_UNKNOWN_M = 10.0
_LONGEST_FIX_LATENCY_S = 0.5
_STANDS_MPS = 1.0
_AGREES_SIGMAS = 3.0
_AGREES_FOR_S = 15.0
_WELL_KNOWN_SHARE = 0.25
_DOUBT_GREW_S = 5.0  # what moved a position within so long is in its velocity, too


class IntegrityMonitor:
    """One fleet. Feed it claims and ranges, call `review` several times a second; it sets `health.contradiction`."""

    def __init__(self, settings: ConsistencySettings | None = None) -> None:
        self.ranges = RangeConsistency(settings)
        self.returning = ReacquisitionMonitor(self.ranges.settings)
        self._agrees_since: dict[int, tuple[float, FloatArray]] = {}

    def claim(self, claim: PositionMeasurement, vehicle: Vehicle) -> None:
        """Take what a vehicle says of its own position; one that is not believed for want of GPS says nothing."""
        if vehicle.health.state not in _CLAIMS_IN or vehicle.health.aided or claim.velocity_enu_mps is None:
            return
        track = ReportedTrack(
            claim.measured_at_s,
            claim.position_enu_m,
            claim.velocity_enu_mps,
            claim.sigma_h_m,
            claim.sigma_v_m,
            free=False,
        )
        self.ranges.place(vehicle.sysid, track)

    def range(self, measurement: RangeMeasurement) -> None:
        """Take a range between two vehicles."""
        self.ranges.range(measurement)
        self.returning.range(measurement)

    def review(self, now_s: float, fleet: VehicleRegistry, frame: LocalFrame | None, answer: Answer) -> None:
        """Place the vehicles without GPS, make the test when it is due, and tell each vehicle's health what came of it."""
        if frame is None:
            return
        for vehicle in fleet:
            if vehicle.health.state in _PLACED_IN:
                where = answer(vehicle.sysid, now_s)
                if isinstance(where, Estimate):
                    sigma_v_m = min(sqrt(float(where.covariance[2, 2])), _SIGMA_V_UNKNOWN_M)
                    (e, n, u), (ve, vn, vu) = where.position_enu_m.tolist(), where.velocity_enu_mps.tolist()
                    self.ranges.place(vehicle.sysid, ReportedTrack(now_s, (e, n, u), (ve, vn, vu), 0.0, sigma_v_m, free=True))
                if vehicle.sysid in self.ranges.accused and self._receiver_agrees(vehicle, frame, where, now_s):
                    self.ranges.acquit(vehicle.sysid)
        self.ranges.review(now_s)
        self.returning.review(now_s, fleet, lambda sysid, at_s: self._doubted(answer(sysid, at_s)))
        for vehicle in fleet:
            sysid, health = vehicle.sysid, vehicle.health
            health.contradiction = self._contradiction(sysid) or self.returning.contradiction(sysid)
            health.return_doubted = self.returning.doubted(sysid)
            health.return_untested = self.returning.untested(sysid, now_s)

    def doubted(self, where: Estimate) -> Estimate:
        """Return an estimate with what a fault that may be at work has done to it in its covariance."""
        doubt_m2 = self.ranges.doubt_m2.get(where.vehicle)
        if doubt_m2 is None or not doubt_m2.any():
            return where
        covariance = where.covariance.copy()
        covariance[:2, :2] += doubt_m2
        covariance[3:5, 3:5] += doubt_m2 / _DOUBT_GREW_S**2
        # As `replace` does, at half the time.
        return Estimate(
            where.vehicle, where.at_s, where.position_enu_m, where.velocity_enu_mps, covariance, where.hdop, where.ranges_in_use
        )

    def _doubted(self, where: Estimate | NoEstimate) -> Estimate | NoEstimate:
        return self.doubted(where) if isinstance(where, Estimate) else where

    def _contradiction(self, sysid: int) -> Contradiction | None:
        accusation = self.ranges.accused.get(sysid)
        if accusation is not None:
            peers = ", ".join(str(peer) for peer in accusation.peers)
            text = f"its GPS position contradicts the ranges to {peers} by {accusation.size_m:.0f} m"
            return Contradiction(text, identified=True)
        if sysid in self.ranges.suspected:
            others = ", ".join(str(other) for other in sorted(self.ranges.suspected - {sysid}))
            text = f"GPS positions and ranges contradict each other; the fault is in it or in {others or 'its ranges'}"
            return Contradiction(text, identified=False)
        return None

    def _receiver_agrees(self, vehicle: Vehicle, frame: LocalFrame, where: Estimate | NoEstimate, now_s: float) -> bool:
        """Whether the real receiver has agreed for a while with a position that is known well enough to tell."""
        fix, accusation = vehicle.receiver, self.ranges.accused[vehicle.sysid]
        if fix is None or fix.fix_type < 3 or isinstance(where, NoEstimate) or now_s - fix.received_at_s > 1.0:
            self._agrees_since.pop(vehicle.sysid, None)
            return False
        place = np.array(frame.enu_from_geodetic(fix.lat_deg, fix.lon_deg, fix.alt_msl_m)[:2])
        age_s, velocity = now_s - fix.received_at_s, where.velocity_enu_mps[:2]
        miss = place - (where.position_enu_m[:2] - velocity * age_s)
        known_m = horizontal_sigma_m(where.covariance)
        sigma_m = hypot(known_m, fix.h_acc_m if fix.h_acc_m is not None else 5.0)
        since_s, first_miss = self._agrees_since.setdefault(vehicle.sysid, (now_s, miss))
        # A position that is less well known than the lie was large would agree with anything.
        if not _explained(miss, velocity, sigma_m) or known_m > _WELL_KNOWN_SHARE * accusation.size_m:
            self._agrees_since.pop(vehicle.sysid)
            return False
        if float(np.hypot(*(miss - first_miss))) > _AGREES_SIGMAS * sigma_m:
            # It is on its way past the true place, not back at it.
            self._agrees_since[vehicle.sysid] = (now_s, miss)
            return False
        if now_s - since_s < _AGREES_FOR_S:
            return False
        del self._agrees_since[vehicle.sysid]
        return True


def _explained(miss: FloatArray, velocity_mps: FloatArray, sigma_m: float) -> bool:
    """Whether a receiver may miss by so much (east and north, m): by its errors, and behind by what it flew since the fix."""
    speed_mps = float(np.hypot(*velocity_mps))
    along = velocity_mps / speed_mps if speed_mps > _STANDS_MPS else np.zeros(2)
    behind_m = min(max(-float(miss @ along), 0.0), speed_mps * _LONGEST_FIX_LATENCY_S)
    return float(np.hypot(*(miss + behind_m * along))) <= _AGREES_SIGMAS * sigma_m
