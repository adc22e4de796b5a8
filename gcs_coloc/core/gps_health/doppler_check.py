"""Doppler check of a receiver: do its fixes move as its own velocity says?

A receiver finds its position by the code of the signals and its velocity by their Doppler shift, so that a fault seldom moves
both alike. The drift is the slope of position minus integrated velocity against time, by least squares over a window.
It is evidence where ranges leave open who is at fault, and of itself no fault: a fix that settles after a shadow drifts as well.
"""

from __future__ import annotations

from collections import deque
from math import hypot, sqrt

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.position_checks import PathStep, path_step
from gcs_coloc.core.messages.inbound import FIX_3D, GpsReceiver

_WINDOW_S = 4.0  # chosen: 2 m/s are then four sigmas of a receiver of 1.5 m at 5 Hz, and detection by ranges takes as long
_LEAST_SPAN_S, _LEAST_FIXES = 3.0, 4  # chosen: a drift of 1 m/s stands out of the noise, and four fixes show that
_LONGEST_GAP_S = 1.5  # of a receiver at 1 Hz, with what the link adds
_SIGMAS = 4.0  # a drift of a sound receiver is larger once in 3,000 windows (Rayleigh)
_HELD_S = 10.0  # chosen: detection and isolation by ranges take some seconds
_UNSTATED_SIGMA_M, _UNSTATED_SIGMA_MPS = 5.0, 0.3  # the second: EK3_VELNE_M_NSE of ArduPilot


class DopplerCheck:
    """The fixes of one receiver. Only those with the autopilot's time of the fix count: arrivals jitter."""

    def __init__(self) -> None:
        self._steps: deque[PathStep] = deque()
        self._frame: LocalFrame | None = None
        self._has_agreed = False
        self._drifted_at_s = float("-inf")

    def add(self, fix: GpsReceiver) -> None:
        """Add a report of the receiver."""
        if fix.fix_type < FIX_3D or fix.velocity_ne_mps is None or fix.fixed_boot_s is None:
            self._clear()
            return
        if self._steps and not 0.0 <= fix.fixed_boot_s - self._steps[-1].at_s <= _LONGEST_GAP_S:
            self._clear()
        if self._steps and fix.fixed_boot_s == self._steps[-1].at_s:
            return
        self._append(fix, fix.fixed_boot_s, fix.velocity_ne_mps)
        self._judge(fix)

    def drifts(self, now_s: float) -> bool:
        """Return whether its fixes have moved of late other than its velocity."""
        return now_s - self._drifted_at_s <= _HELD_S

    def _append(self, fix: GpsReceiver, at_s: float, velocity_ne_mps: tuple[float, float]) -> None:
        if self._frame is None:
            self._frame = LocalFrame(fix.lat_deg, fix.lon_deg, fix.alt_msl_m)
        vn, ve = velocity_ne_mps
        ve_mps, vn_mps, _ = self._frame.enu_from_ned_velocity(fix.lat_deg, fix.lon_deg, (vn, ve, 0.0))
        east_m, north_m, _ = self._frame.enu_from_geodetic(fix.lat_deg, fix.lon_deg, fix.alt_msl_m)
        last = self._steps[-1] if self._steps else None
        self._steps.append(path_step(last, at_s, (east_m, north_m), (ve_mps, vn_mps)))
        while at_s - self._steps[0].at_s > _WINDOW_S:
            self._steps.popleft()

    def _judge(self, fix: GpsReceiver) -> None:
        steps = self._steps
        if len(steps) < _LEAST_FIXES or steps[-1].at_s - steps[0].at_s < _LEAST_SPAN_S:
            return
        mean_s = sum(step.at_s for step in steps) / len(steps)
        spread_s2 = sum((step.at_s - mean_s) ** 2 for step in steps)
        drift_mps = hypot(
            sum((step.at_s - mean_s) * (step.east_m - step.path_east_m) for step in steps) / spread_s2,
            sum((step.at_s - mean_s) * (step.north_m - step.path_north_m) for step in steps) / spread_s2,
        )
        sigma_m = fix.h_acc_m if fix.h_acc_m is not None else _UNSTATED_SIGMA_M
        sigma_mps = fix.speed_acc_mps if fix.speed_acc_mps is not None else _UNSTATED_SIGMA_MPS
        if drift_mps <= _SIGMAS * hypot(sigma_m / sqrt(spread_s2), sigma_mps):
            self._has_agreed = True
        elif self._has_agreed:
            # One whose velocity never fitted states none that is worth anything.
            self._drifted_at_s = fix.received_at_s

    def _clear(self) -> None:
        self._steps.clear()
        self._frame = None
