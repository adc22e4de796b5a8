"""Does a vehicle report the position that its own receiver states? Its autopilot may be flying on something else.

GLOBAL_POSITION_INT is a filter's output, and the receiver's signs of health say nothing of it: the filter may be set to other
sources (vision, beacons, another receiver), may refuse the receiver and reckon on, or follow one that has just jumped.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from gcs_coloc.core.geodesy import horizontal_distance_m
from gcs_coloc.core.gps_health.reasons import GpsReason
from gcs_coloc.core.messages.inbound import GlobalPosition, GpsReceiver
from gcs_coloc.core.reasons import StatedReason

_SIGMAS = 5.0
_UNSTATED_SIGMA_M = 5.0
_LEAST_MISS_M = 10.0
_APART_IN_TIME_S = 2.0  # a receiver's delay and the gap between two messages that are sent once a second
_PERSISTS_S = 3.0
_HAS_FIX = 3


@dataclass(slots=True)
class ReceiverCheck:
    """The check of one vehicle. `fault`: how far its reported position is off its receiver's; None where it is not."""

    fault: StatedReason[GpsReason] | None = None
    _off_since_s: float | None = None

    def add(self, fix: GpsReceiver, position: GlobalPosition | None) -> None:
        """Add a report of the vehicle's own receiver beside the position that it reported last.

        They are of different times: what the vehicle flies in `_APART_IN_TIME_S` is allowed for, beside five sigmas of the
        receiver. A single pair tells nothing, `_PERSISTS_S` of them in a row do.
        """
        if position is None or fix.fix_type < _HAS_FIX or fix.received_at_s - position.received_at_s > _APART_IN_TIME_S:
            self.fault = self._off_since_s = None
            return
        off_m = horizontal_distance_m(fix.lat_deg, fix.lon_deg, position.lat_deg, position.lon_deg)
        sigma_m = fix.h_acc_m if fix.h_acc_m is not None else _UNSTATED_SIGMA_M
        flown_m = _APART_IN_TIME_S * hypot(position.vn_mps, position.ve_mps)
        if off_m <= _SIGMAS * sigma_m + _LEAST_MISS_M + flown_m:
            self.fault = self._off_since_s = None
            return
        if self._off_since_s is None:
            self._off_since_s = fix.received_at_s
        if fix.received_at_s - self._off_since_s >= _PERSISTS_S:
            self.fault = StatedReason(GpsReason.OFF_ITS_RECEIVER, off_m)
