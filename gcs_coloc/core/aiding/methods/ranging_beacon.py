"""RANGING_BEACON: hands vetted ranges, with the positions of the peers, to PX4's EKF2.

EKF2 fuses the ranges itself. Each range carries its own uncertainty, so that even one helps where no position can be stated:
EKF2 is corrected along its direction.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from math import dist, inf, sqrt

import numpy as np

from gcs_coloc.core.aiding.inhibit import InhibitReason
from gcs_coloc.core.aiding.methods.method import AidingMethod, MethodContext, Moment
from gcs_coloc.core.measurements import Estimate, RangeMeasurement, Residual
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, RangingBeacon
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, is_station, station_id_of

LEAST_INTERVAL_S = 0.065
"""EKF2 drops a sample that is younger than the last by less than its buffer's step; flown: of three in a burst it used one."""
PERIOD_S = 0.07
"""Chosen: the shortest round period above that; 14 ranges a second, three peers at 5 Hz."""
_LONGEST_AGE_S = 0.2
"""Chosen: EKF2's horizon lies 0.2 s back (EKF2_DELAY_MAX), and a sample that comes much later than it is never fused."""
_OLDEST_S = 1.0  # chosen: an older range is worth less than the next one
_HANDED_S = 2.0  # chosen: for so long after the last message ranges count as being handed over
_VEHICLE_IDS_FROM = 256  # chosen: above the 8-bit ids of ground stations
_VEHICLE_IDS = MAX_STATION_ID + 1 - _VEHICLE_IDS_FROM
"""How many beacon_id are left for vehicles. Vehicle N has `_VEHICLE_IDS_FROM` + N, so that it is not taken for a station.
EKF2 does not tell beacons apart."""
_STOPPING = (InhibitReason.RANGES_INCONSISTENT, InhibitReason.RANGES_JUMPED)
"""While the ranges themselves may be wrong none is handed over; every other reason concerns the position alone."""
_LEAST_DISTANCE_M = 1.0  # below it the direction of a range is noise
_MAX_WAITING = 4096  # chosen: some seconds of a large fleet; the estimator tells of a range within its window
_MAX_READY = 64  # chosen: of one vehicle, more than is handed over in a second


class RangingBeaconMethod(AidingMethod):
    """RANGING_BEACON, one range each `PERIOD_S`, stamped by the vehicle's own boot clock.

    PX4 does not convert the stamp.

    Ranges to several peers are measured at nearly one time, and arrive late. So each is brought to the time of its stamp: it is
    lengthened by what the distance has grown since, as the estimates say.
    """

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._newest: dict[int, RangeMeasurement] = {}
        self._sent_s: dict[int, float] = {}
        self._last_sent_s = self._stamped_s = -inf
        self._now_s = -inf
        self._sequence = 0

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the base says."""
        self._now_s = now_s = moment.now_s
        self._newest |= {m.other_end(self._sysid): m for m in moment.known.ranges}
        self._newest = {peer: one for peer, one in self._newest.items() if now_s - one.measured_at_s <= _OLDEST_S}
        if moment.inhibit is not None and moment.inhibit.reason in _STOPPING:
            self._newest.clear()
        if not self._newest or moment.frame is None:
            return []
        # The peer that has waited longest, so that all have their turn.
        peer, one = min(self._newest.items(), key=lambda each: (self._sent_s.get(each[0], -inf), each[1].measured_at_s))
        at_s = max(one.measured_at_s, self._stamped_s + LEAST_INTERVAL_S, moment.arrives_s - _LONGEST_AGE_S)
        if at_s > moment.arrives_s:
            return []
        # Even where no message comes of it: kept, it would have its turn again and again before the other peers.
        del self._newest[peer]
        message = self._message(peer, one, at_s, moment)
        if message is None:
            return []
        self._sent_s[peer] = self._last_sent_s = now_s
        self._stamped_s = at_s
        return [message]

    def _message(self, node: int, one: RangeMeasurement, at_s: float, moment: Moment) -> RangingBeacon | None:
        """Build the message of a range to a node that is brought to a time (service time, s).

        None where the vehicle's clock is not known, the peer is not located, or the range cannot be brought to that time.
        """
        assert moment.frame is not None
        boot_s = moment.known.boot_s(at_s)
        peer = moment.known.locate_node(node, at_s)
        if boot_s is None or not isinstance(peer, Estimate):
            return None
        brought = self._brought(one, node, peer, at_s, moment)
        if brought is None:
            return None
        range_m, variance_m2 = brought
        there = peer.position_enu_m.tolist()
        lat_deg, lon_deg, alt_msl_m = moment.frame.geodetic_from_enu(*there)
        self._sequence = (self._sequence + 1) & 0xFF
        return RangingBeacon(
            sysid=self._sysid,
            boot_us=round(boot_s * 1e6),
            beacon_id=station_id_of(node) if is_station(node) else _VEHICLE_IDS_FROM + node % _VEHICLE_IDS,
            sequence=self._sequence,
            range_m=range_m,
            accuracy_m=sqrt(variance_m2),
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            alt_msl_m=alt_msl_m,
            sigma_h_m=sqrt(0.5 * float(np.trace(peer.covariance[:2, :2]))),
            sigma_v_m=sqrt(float(peer.covariance[2, 2])),
        )

    def _brought(
        self, one: RangeMeasurement, node: int, peer: Estimate, at_s: float, moment: Moment
    ) -> tuple[float, float] | None:
        """Return a range brought to a time, m, and its variance, m^2; None where that cannot be done.

        The variance includes that of the peer's position. A range that was measured at that very time needs no estimate of the
        vehicle.
        """
        own, own_then = (moment.known.locate_node(self._sysid, then_s) for then_s in (at_s, one.measured_at_s))
        if not isinstance(own, Estimate) or not isinstance(own_then, Estimate):
            worst_m2 = float(np.linalg.eigvalsh(peer.covariance[:3, :3])[-1])
            return (one.range_m, one.sigma_m**2 + worst_m2) if at_s == one.measured_at_s else None
        peer_then = moment.known.locate_node(node, one.measured_at_s)
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

    def with_fix(self) -> str:
        """As the base says."""
        return "RANGING_BEACON" if self._is_handing_over else "nothing: no range that it can use"

    def without_fix(self) -> str:
        """As the base says."""
        return "ranges alone by RANGING_BEACON" if self._is_handing_over else "nothing"

    @property
    def _is_handing_over(self) -> bool:
        return self._now_s - self._last_sent_s <= _HANDED_S


@dataclass(slots=True)
class _Waiting:
    """The ranges of one pair at one time, by device, and how many of them the estimator has used."""

    of_device: dict[int, RangeMeasurement] = field(default_factory=dict)
    used: int = 0


class VettedRanges:
    """The ranges to trusted nodes that the estimator has used and that have not been handed over yet.

    `wants` says of a system id whether that vehicle is handed ranges.
    """

    def __init__(self, wants: Callable[[int], bool]) -> None:
        self._wants = wants
        self._waiting: OrderedDict[tuple[int, int, float], _Waiting] = OrderedDict()
        self._ready: dict[int, list[RangeMeasurement]] = {}

    def forget(self, vehicle: int) -> None:
        """Forget the vetted ranges of a vehicle."""
        self._ready.pop(vehicle, None)

    def add_range(self, m: RangeMeasurement) -> None:
        """Add a range that the estimator was given."""
        if not (self._wants(m.from_vehicle) or self._wants(m.to_vehicle)):
            return
        self._waiting.setdefault((m.from_vehicle, m.to_vehicle, m.measured_at_s), _Waiting()).of_device[m.device_id] = m
        if len(self._waiting) > _MAX_WAITING:
            self._waiting.popitem(last=False)

    def add_residuals(self, residuals: Iterable[Residual], is_trusted: Callable[[int], bool]) -> None:
        """Add what the estimator made of ranges: those that it used become vetted ones.

        A range to a node that is not trusted is left out. A residual does not name its device: of several that ranged one peer at
        one time all must have been used.
        """
        if not self._waiting:
            return
        for r in residuals:
            if r.to_vehicle is None or (waiting := self._waiting.get((r.from_vehicle, r.to_vehicle, r.measured_at_s))) is None:
                continue
            waiting.used += 1
            if r.refused is None and waiting.used < len(waiting.of_device):
                continue
            del self._waiting[r.from_vehicle, r.to_vehicle, r.measured_at_s]
            if r.refused is None:
                for m in waiting.of_device.values():
                    self._add_vetted(m, is_trusted)

    def _add_vetted(self, m: RangeMeasurement, is_trusted: Callable[[int], bool]) -> None:
        for vehicle in m.ends:
            if self._wants(vehicle) and is_trusted(m.other_end(vehicle)):
                ready = self._ready.setdefault(vehicle, [])
                ready.append(m)
                del ready[:-_MAX_READY]

    def drain(self, vehicle: int) -> tuple[RangeMeasurement, ...]:
        """Return the vetted ranges of a vehicle since the last call."""
        return tuple(self._ready.pop(vehicle, ()))
