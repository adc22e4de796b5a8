"""RANGING_BEACON: hands vetted ranges, with the positions of the peers, to PX4's EKF2.

EKF2 fuses the ranges itself. Each range carries its own uncertainty, so that even one helps where no position can be stated:
EKF2 is corrected along its direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, inf, sqrt

import numpy as np

from gcs_coloc.core.aiding.inhibit import InhibitReason
from gcs_coloc.core.aiding.methods.method import MethodContext, Moment
from gcs_coloc.core.aiding.vetted_ranges import VettedRange
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.inbound import CommandResult
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, RangingBeacon
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, is_station, station_id_of

LEAST_INTERVAL_S = 0.065
"""EKF2 drops a sample that is younger than the last by less than its buffer's step; flown: of three in a burst it used one."""
PERIOD_S = 0.07
"""Chosen: the shortest round period above that; 14 ranges a second, three peers at 5 Hz."""
_LONGEST_AGE_S = 0.2
"""Chosen: EKF2's horizon lies 0.2 s back (EKF2_DELAY_MAX), and a sample that comes much later than it is never fused."""
_OLDEST_S = 1.0
"""Chosen: an older range is worth less than the next one."""
_HANDED_S = 2.0
"""Chosen: for so long after the last message ranges count as being handed over."""
_VEHICLE_IDS_FROM = 256  # chosen: above the 8-bit ids of ground stations
_VEHICLE_IDS = MAX_STATION_ID + 1 - _VEHICLE_IDS_FROM
"""How many beacon_id are left for vehicles. Vehicle N has `_VEHICLE_IDS_FROM` + N, so that it is not taken for a station.
EKF2 does not tell beacons apart."""
_STOPPING = (InhibitReason.RANGES_INCONSISTENT, InhibitReason.RANGES_JUMPED)
"""While the ranges themselves may be wrong none is handed over; every other reason concerns the position alone."""
_LEAST_DISTANCE_M = 1.0  # below it the direction of a range is noise


class RangingBeaconMethod:
    """RANGING_BEACON, one range each `PERIOD_S`, stamped by the vehicle's own boot clock.

    PX4 does not convert the stamp.

    Ranges to several peers are measured at nearly one time, and arrive late. So each is brought to the time of its stamp: it is
    lengthened by what the distance has grown since, as the estimates say.
    """

    age_s = 0.0

    def __init__(self, context: MethodContext) -> None:
        self._sysid = context.sysid
        self._newest: dict[int, VettedRange] = {}
        self._sent_s: dict[int, float] = {}
        self._last_sent_s = self._stamped_s = -inf
        self._now_s = -inf
        self._sequence = 0

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        self._now_s = now_s = moment.now_s
        self._newest |= {one.peer: one for one in moment.ranges}
        self._newest = {peer: one for peer, one in self._newest.items() if now_s - one.measured_at_s <= _OLDEST_S}
        if moment.inhibit is not None and moment.inhibit.reason in _STOPPING:
            self._newest.clear()
        if not self._newest or moment.frame is None:
            return []
        # The peer that has waited longest, so that all have their turn.
        one = min(self._newest.values(), key=lambda each: (self._sent_s.get(each.peer, -inf), each.measured_at_s))
        at_s = max(one.measured_at_s, self._stamped_s + LEAST_INTERVAL_S, moment.arrives_s - _LONGEST_AGE_S)
        if at_s > moment.arrives_s:
            return []
        # Even where no message comes of it: kept, it would have its turn again and again before the other peers.
        del self._newest[one.peer]
        message = self._message(one, at_s, moment)
        if message is None:
            return []
        self._sent_s[one.peer] = self._last_sent_s = now_s
        self._stamped_s = at_s
        return [message]

    def _message(self, one: VettedRange, at_s: float, moment: Moment) -> RangingBeacon | None:
        """Build the message of a range that is brought to a time (service time, s).

        None where the vehicle's clock is not known, the peer is not located, or the range cannot be brought to that time.
        """
        assert moment.frame is not None
        boot_s = moment.boot_s(at_s)
        peer = moment.locate_node(one.peer, at_s)
        if boot_s is None or not isinstance(peer, Estimate):
            return None
        brought = self._brought(one, peer, at_s, moment)
        if brought is None:
            return None
        range_m, variance_m2 = brought
        there = peer.position_enu_m.tolist()
        lat_deg, lon_deg, alt_msl_m = moment.frame.geodetic_from_enu(*there)
        self._sequence = (self._sequence + 1) & 0xFF
        return RangingBeacon(
            sysid=self._sysid,
            boot_us=round(boot_s * 1e6),
            beacon_id=station_id_of(one.peer) if is_station(one.peer) else _VEHICLE_IDS_FROM + one.peer % _VEHICLE_IDS,
            sequence=self._sequence,
            range_m=range_m,
            accuracy_m=sqrt(variance_m2),
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_msl_m=alt_msl_m,
            sigma_h_m=sqrt(0.5 * float(np.trace(peer.covariance[:2, :2]))),
            sigma_v_m=sqrt(float(peer.covariance[2, 2])),
        )

    def _brought(self, one: VettedRange, peer: Estimate, at_s: float, moment: Moment) -> tuple[float, float] | None:
        """Return a range brought to a time, m, and its variance, m^2; None where that cannot be done.

        The variance includes that of the peer's position. A range that was measured at that very time needs no estimate of the
        vehicle.
        """
        own, own_then = (moment.locate_node(self._sysid, then_s) for then_s in (at_s, one.measured_at_s))
        if not isinstance(own, Estimate) or not isinstance(own_then, Estimate):
            worst_m2 = float(np.linalg.eigvalsh(peer.covariance[:3, :3])[-1])
            return (one.range_m, one.sigma_m**2 + worst_m2) if at_s == one.measured_at_s else None
        peer_then = moment.locate_node(one.peer, one.measured_at_s)
        if not isinstance(peer_then, Estimate):
            return None
        distance_m = dist(own.position_enu_m, peer.position_enu_m)
        range_m = one.range_m + distance_m - dist(own_then.position_enu_m, peer_then.position_enu_m)
        if distance_m < _LEAST_DISTANCE_M or range_m <= 0.0:
            return None
        u = (own.position_enu_m - peer.position_enu_m) / distance_m
        # The peer's uncertainty along the line of sight, and that of how fast the distance grows.
        speed = own.covariance[3:, 3:] + peer.covariance[3:, 3:]
        moved_s = at_s - one.measured_at_s
        return range_m, one.sigma_m**2 + float(u @ peer.covariance[:3, :3] @ u) + moved_s**2 * float(u @ speed @ u)

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """As the protocol says: the message cannot say that there is no range."""
        return []

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says: no command is sent."""
        del result
        return []

    def with_fix(self) -> str:
        """As the protocol says."""
        return "RANGING_BEACON" if self._is_handing_over else "nothing: no range that it can use"

    def without_fix(self) -> str:
        """As the protocol says."""
        return "ranges alone by RANGING_BEACON" if self._is_handing_over else "nothing"

    @property
    def _is_handing_over(self) -> bool:
        return self._now_s - self._last_sent_s <= _HANDED_S
