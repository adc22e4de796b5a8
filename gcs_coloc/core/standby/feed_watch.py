"""What vehicles show of who feeds them, and which may be fed while the other service is silent.

They show the other service's stream as they pass it on, and the fixes of the fed receiver.
ArduPilot and routers pass on what has no target, as GPS_INPUT, over their other links (MAVLink routing). And GPS2_RAW tells when
the fed receiver had its last fix. A vehicle that shows neither shows nothing: it may be fed or not.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from gcs_coloc.core.standby.sign_of_life import PRESENT_S, OtherService

_HEARD_WITHIN_S = 0.5  # chosen: a vehicle sends its position ten times a second; one that is silent shows nothing
_PASSES_ON_AFTER = 3
"""Messages of the other's stream, after which their absence counts. Chosen: one may come by a detour that is no link."""
_SLOWEST_REPORTS_S = 0.35
"""Time between two reports of the fed receiver. Chosen: of the 5 Hz that are requested of it one may be late."""
_UNCHANGED_S = 0.15  # chosen: an active service sends ten fixes a second; without one for so long a receiver is not fed
_LISTEN_S = 0.5
"""While the other one is silent a vehicle is watched for so long before it is fed anew. Chosen: five fixes of the other's."""
_WANTED_S = 1.0
"""A vehicle that needs aid and is fed by nobody, before a standby takes over for it: twice as long as an active one waits."""
_SENT_LATELY_S = 1.0  # chosen: a vehicle that we fed so lately nobody else has begun to feed


@dataclass(slots=True)
class _Vehicle:
    """What one vehicle has shown of who feeds it.

    Times are service time in s, minus infinity for never. `passed_on`, `passed_on_at_s`: how many messages of the other's
    stream, and when the last. `fixed_boot_s`: the last fix of the fed receiver by the vehicle's clock, `fixed_at_s`: when that
    was first reported, `is_advance` whether another was known before; `reported_at_s` and `report_before_s`: the last reports.
    `sent_at_s`: when we fed it last. `wanted_since_s`: since when this service would feed it, None where it would not.
    `is_granted`: a take-over was for it, so that it is fed at once.
    """

    heard_at_s: float = float("-inf")
    passed_on: int = 0
    passed_on_at_s: float = float("-inf")
    fixed_boot_s: float | None = None
    fixed_at_s: float = float("-inf")
    is_advance: bool = False
    reported_at_s: float = float("-inf")
    report_before_s: float = float("-inf")
    sent_at_s: float = float("-inf")
    wanted_since_s: float | None = None
    is_granted: bool = False


class FeedWatch:
    """Which vehicles the other service feeds, by what they show, and which may be fed while it is silent.

    `period_s` is the time between two fixes, the same for both services.
    """

    def __init__(self, period_s: float, other: OtherService) -> None:
        self._silent_after_s = 2.5 * max(period_s, 0.1)
        self._other = other
        self._vehicles: dict[int, _Vehicle] = {}

    def add_heard(self, sysid: int, at_s: float) -> None:
        """Add that a vehicle was heard."""
        self._vehicle(sysid).heard_at_s = at_s

    def add_passed_on(self, sysid: int, at_s: float) -> None:
        """Add a message of the other's stream that a vehicle, or the router before it, has passed on."""
        vehicle = self._vehicle(sysid)
        vehicle.heard_at_s = vehicle.passed_on_at_s = at_s
        vehicle.passed_on += 1

    def add_fed_receiver(self, sysid: int, at_s: float, fixed_boot_s: float | None) -> None:
        """Add a report of the receiver that is fed, with the time of its last fix by the vehicle's clock (s)."""
        vehicle = self._vehicle(sysid)
        vehicle.heard_at_s = at_s
        vehicle.report_before_s, vehicle.reported_at_s = vehicle.reported_at_s, at_s
        if fixed_boot_s != vehicle.fixed_boot_s:
            vehicle.is_advance = vehicle.fixed_boot_s is not None and fixed_boot_s is not None
            vehicle.fixed_boot_s, vehicle.fixed_at_s = fixed_boot_s, at_s

    def add_fed(self, sysid: int, at_s: float) -> None:
        """Add that a vehicle is sent something that changes what it does: a new fix is ours then."""
        self._vehicle(sysid).sent_at_s = at_s

    def set_wanted(self, wanted: Collection[int], now_s: float) -> None:
        """Set the vehicles to which this service would send something that changes what they do."""
        for sysid in wanted:
            vehicle = self._vehicle(sysid)
            vehicle.wanted_since_s = now_s if vehicle.wanted_since_s is None else vehicle.wanted_since_s
        for sysid in self._vehicles.keys() - set(wanted):
            self._vehicles[sysid].wanted_since_s, self._vehicles[sysid].is_granted = None, False

    def grant(self, sysids: Collection[int]) -> None:
        """Let these vehicles, and no others, be fed at once."""
        for sysid, vehicle in self._vehicles.items():
            vehicle.is_granted = sysid in sysids

    def fed_lately(self, now_s: float) -> tuple[int, ...]:
        """Return the vehicles that we have fed of late."""
        return tuple(sorted(sysid for sysid, v in self._vehicles.items() if now_s - v.sent_at_s <= _SENT_LATELY_S))

    def free(self, now_s: float) -> set[int]:
        """Return the vehicles that need aid and show that nobody feeds them.

        That counts at once where the other service fed one, otherwise after a while.
        """
        found = set()
        for sysid, vehicle in self._vehicles.items():
            if vehicle.wanted_since_s is None or not self._is_fed_no_more(vehicle, now_s):
                continue
            was_fed = sysid in self._other.shared.feeding or now_s - self._fed_at_s(vehicle, now_s) <= PRESENT_S
            if was_fed or now_s - max(vehicle.wanted_since_s, self._other.listening_since_s) >= _WANTED_S:
                found.add(sysid)
        return found

    def unknown(self, now_s: float) -> tuple[int, ...]:
        """Return the vehicles that have needed aid for a while and show nothing of who feeds them."""
        return tuple(
            sorted(
                sysid
                for sysid, vehicle in self._vehicles.items()
                if vehicle.wanted_since_s is not None
                and now_s - vehicle.wanted_since_s >= _WANTED_S
                and not self._shows(vehicle, now_s)
            )
        )

    def may_feed_in_silence(self, sysid: int, now_s: float) -> bool:
        """Return whether a vehicle may be fed though nobody knows what the other one does."""
        vehicle = self._vehicle(sysid)
        if vehicle.is_granted or now_s - vehicle.sent_at_s <= _SENT_LATELY_S:
            return True
        wanted_since_s = now_s if vehicle.wanted_since_s is None else vehicle.wanted_since_s
        since_s = max(wanted_since_s, self._other.listening_since_s, self._fed_at_s(vehicle, now_s))
        return now_s - since_s >= _LISTEN_S

    def fed_vehicle(self, now_s: float, since_s: float = float("-inf")) -> int | None:
        """Return a vehicle that has shown after `since_s` that the other service feeds it; None without one."""
        for sysid, vehicle in self._vehicles.items():
            fed_at_s = self._fed_at_s(vehicle, now_s)
            if fed_at_s > since_s and now_s - fed_at_s <= self._silent_after_s:
                return sysid
        return None

    def _shows(self, vehicle: _Vehicle, now_s: float) -> bool:
        """Return whether a vehicle would show that it is fed."""
        return now_s - vehicle.heard_at_s <= _HEARD_WITHIN_S and (self._passes_on(vehicle) or _reports(vehicle, now_s))

    def _is_fed_no_more(self, vehicle: _Vehicle, now_s: float) -> bool:
        """Return whether a vehicle shows that nobody feeds it now."""
        if not self._shows(vehicle, now_s):
            return False
        if self._passes_on(vehicle):
            return now_s - vehicle.passed_on_at_s > self._silent_after_s
        return vehicle.reported_at_s - vehicle.fixed_at_s >= _UNCHANGED_S

    def _fed_at_s(self, vehicle: _Vehicle, now_s: float) -> float:
        """Return when a vehicle last showed that the other service feeds it; minus infinity for never.

        A fix may have come up to a report's spacing before its report.
        """
        if self._passes_on(vehicle) or not _reports(vehicle, now_s):
            return vehicle.passed_on_at_s
        is_others = vehicle.is_advance and vehicle.fixed_at_s - vehicle.sent_at_s > _SLOWEST_REPORTS_S
        return max(vehicle.passed_on_at_s, vehicle.fixed_at_s if is_others else float("-inf"))

    def _passes_on(self, vehicle: _Vehicle) -> bool:
        return vehicle.passed_on >= _PASSES_ON_AFTER

    def _vehicle(self, sysid: int) -> _Vehicle:
        return self._vehicles.setdefault(sysid, _Vehicle())


def _reports(vehicle: _Vehicle, now_s: float) -> bool:
    """Return whether the reports of the fed receiver come often enough to show who feeds a vehicle."""
    spacing_s = vehicle.reported_at_s - vehicle.report_before_s
    return spacing_s <= _SLOWEST_REPORTS_S and now_s - vehicle.reported_at_s <= _HEARD_WITHIN_S
