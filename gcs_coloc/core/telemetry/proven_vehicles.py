"""The proven vehicles: those whose messages are evidence for the position of others.

On an unsigned link one sender may state any number of vehicles, so what counts is where a vehicle is heard and who measures it.
A vehicle is proven that

- was there when the fleet began, but for one that shares its address beside others that do not;
- is heard for a while from an address that is its alone;
- shares its address and is measured by the ranging devices of proven vehicles, at ranges that fit its position;
- the operator declares healthy.

A proven vehicle that fell silent is proven again once its autopilot is heard alone, or among those that it was among before.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from math import dist, hypot

from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.core.messages.control import RouteBlock
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.telemetry.reported_state import ReportedState

FOUNDING_S = 10.0
"""Who is heard so soon after the first vehicle is of the fleet. Chosen: ten heartbeats, of which a slow radio passes some."""
STEADY_S = 3.0
"""A newcomer is heard, and measured, for so long before it is proven. Chosen: three heartbeats."""
SILENT_S = 5.0
"""A vehicle that was silent for so long may be another sender. The links bind its system id anew then (`rebind_after_s`)."""
_TOLD_AFTER_S = 10.0  # chosen: a vehicle that is measured is proven long before
_UNPROVEN = (
    "shares its address with other vehicles and is new there: it is no evidence for others until vehicles that are known measure "
    "ranges to it that fit its position; declare its GPS healthy where you know it"
)
_FIT_SIGMAS = 4.0  # chosen: refuses one sound range in sixteen thousand
_PROVING_RANGES = 2  # chosen: one range fits by chance wherever the newcomer is on a circle
_EXTRAPOLATED_S = 2.0  # chosen: a manoeuvre of 5 m/s^2 moves a vehicle by 10 m in it


@dataclass(slots=True)
class _Fit:
    """How the ranges of one proven vehicle to a newcomer fit the newcomer's position.

    `since_s`: since when they fit without an exception; infinity where the newest does not. `at_s`: when the newest came. Both
    are service time.
    """

    since_s: float
    at_s: float


@dataclass(slots=True)
class _Sender:
    """What is known of one vehicle as the sender of messages.

    `companions`: the proven vehicles at its address when it was itself proven and heard last.
    """

    is_proven: bool
    has_returned: bool = False
    companions: Collection[int] = ()
    returned_at_s: float = float("-inf")
    is_reported: bool = False
    fits: dict[int, _Fit] = field(default_factory=dict)


class ProvenVehicles:
    """The proven vehicles of one fleet: `add` each new vehicle, `review` all several times a second."""

    def __init__(self) -> None:
        self._senders: dict[int, _Sender] = {}
        self._began_s: float | None = None

    def add(self, sysid: int, at_s: float) -> None:
        """Add a vehicle that is heard for the first time."""
        self._began_s = at_s if self._began_s is None else self._began_s
        self._senders[sysid] = _Sender(is_proven=at_s - self._began_s < FOUNDING_S)

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that made room for another one."""
        del self._senders[sysid]

    def is_proven(self, sysid: int) -> bool:
        """Return whether what a vehicle reports and measures is evidence for others."""
        sender = self._senders.get(sysid)
        return sender is not None and sender.is_proven

    def update(self, vehicle: ReportedState, at_s: float) -> None:
        """Update a vehicle of which a message has arrived, before its reported state is updated."""
        sender = self._senders[vehicle.sysid]
        if at_s - vehicle.last_heard_s > SILENT_S and vehicle.route_at_s is not None:
            sender.has_returned = sender.has_returned or sender.is_proven
            sender.is_proven, sender.returned_at_s = False, at_s

    def add_range(
        self, measurement: RangeMeasurement, measured_from: PositionMeasurement | None, to: PositionMeasurement | None
    ) -> None:
        """Add a range that a proven vehicle measured to one that is not.

        `measured_from` and `to` are the reported positions of the two ends, None where an end has none that is evidence.

        What a newcomer measures itself proves nothing. One whose position is no evidence (`to` is None) is measured all the
        same.
        """
        newcomer, peer = self._senders.get(measurement.to_vehicle), measurement.from_vehicle
        if newcomer is None or newcomer.is_proven or not self.is_proven(peer):
            return
        at_s, fit = measurement.arrived_at_s, newcomer.fits.get(peer)
        if to is not None:
            if measured_from is None:
                return
            apart = _apart_m(measured_from, to, measurement.measured_at_s)
            if apart is None:
                return
            distance_m, sigma_m = apart
            if abs(measurement.range_m - distance_m) > _FIT_SIGMAS * hypot(measurement.sigma_m, sigma_m):
                newcomer.fits[peer] = _Fit(float("inf"), at_s)
                return
        if fit is None or fit.since_s > at_s or at_s - fit.at_s > STEADY_S:
            newcomer.fits[peer] = _Fit(at_s, at_s)
        else:
            fit.at_s = at_s

    def review(self, vehicles: Collection[ReportedState], vouched: Collection[int], now_s: float) -> list[Notice]:
        """Find who is proven now; the operator declares the `vouched` healthy. Return what is to be told."""
        out: list[Notice] = []
        is_founding = self._began_s is not None and now_s - self._began_s < FOUNDING_S
        any_alone = any(vehicle.blocked is None for vehicle in vehicles)
        has_routes = any(vehicle.route_at_s is not None for vehicle in vehicles)
        heard = [vehicle.sysid for vehicle in vehicles if now_s - vehicle.last_heard_s <= SILENT_S]
        proven = {sysid for sysid in heard if self.is_proven(sysid)}
        for vehicle in vehicles:
            sender, is_shared = self._senders[vehicle.sysid], vehicle.blocked is RouteBlock.SHARED_ADDRESS
            if sender.is_proven:
                if is_founding and is_shared and any_alone:
                    sender.is_proven = False
                elif vehicle.sysid in proven:
                    sender.companions = proven & set(vehicle.shared_with)
            elif vehicle.sysid in vouched or self._proves(vehicle, sender, len(proven), now_s, has_routes=has_routes):
                sender.is_proven, sender.has_returned = True, False
                if sender.is_reported:
                    out.append(Notice(now_s, vehicle.sysid, "info", "its position is evidence for others from now on"))
                    sender.is_reported = False
            elif is_shared and not sender.is_reported and now_s - vehicle.first_heard_s >= _TOLD_AFTER_S:
                sender.is_reported = True
                out.append(Notice(now_s, vehicle.sysid, "warning", _UNPROVEN))
        return out

    def replaceable(self, vehicles: Collection[ReportedState], now_s: float) -> list[int]:
        """Return who may make room, the longest silent first: never proven, and silent or of a shared address."""
        unproven = [v for v in vehicles if not self._senders[v.sysid].is_proven and not self._senders[v.sysid].has_returned]
        found = [v for v in unproven if v.blocked is RouteBlock.SHARED_ADDRESS or now_s - v.last_heard_s > SILENT_S]
        return [vehicle.sysid for vehicle in sorted(found, key=lambda vehicle: vehicle.last_heard_s)]

    @staticmethod
    def _proves(vehicle: ReportedState, sender: _Sender, proven: int, now_s: float, *, has_routes: bool) -> bool:
        """Return whether a vehicle that is not proven has become so, beside so many that are."""
        if now_s - vehicle.last_heard_s > SILENT_S:
            return False
        if sender.has_returned:
            is_located = vehicle.route_at_s is not None and vehicle.route_at_s >= sender.returned_at_s
            if is_located and (not vehicle.shared_with or set(vehicle.shared_with) & set(sender.companions)):
                return True
        elif vehicle.blocked is None or not has_routes:
            return now_s - vehicle.first_heard_s >= STEADY_S
        fits = [fit for fit in sender.fits.values() if now_s - fit.at_s <= STEADY_S]
        lasting = [fit for fit in fits if now_s - fit.since_s >= STEADY_S]
        return len(lasting) >= min(_PROVING_RANGES, max(proven, 1)) and 2 * len(lasting) > len(fits)


def _apart_m(one: PositionMeasurement, other: PositionMeasurement, at_s: float) -> tuple[float, float] | None:
    """Return distance and 1-sigma of two reported positions at a time, m; None where one is too old."""
    places = []
    for position in (one, other):
        since_s = at_s - position.measured_at_s
        if abs(since_s) > _EXTRAPOLATED_S:
            return None
        velocity_mps = position.velocity_enu_mps if position.velocity_enu_mps is not None else (0.0, 0.0, 0.0)
        places.append([x + v * since_s for x, v in zip(position.position_enu_m, velocity_mps, strict=True)])
    return dist(*places), hypot(one.sigma_h_m, one.sigma_v_m, other.sigma_h_m, other.sigma_v_m)
