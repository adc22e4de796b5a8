"""The clocks of one fleet: the time of each message, TIMESYNC, UTC, and system ids that two share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import hypot

from gcs_coloc.core.clocks.sender_clock import SenderClock
from gcs_coloc.core.clocks.utc import HostClockFault, Utc
from gcs_coloc.core.clocks.vehicle_clocks import ONE_WAY, ServiceTime, TimeSettings, VehicleClock
from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.messages.inbound import (
    Attitude,
    GlobalPosition,
    GpsReceiver,
    PeerRange,
    Pressure,
    SystemTime,
    TimeBase,
    TimeSyncAnswer,
)
from gcs_coloc.core.messages.outbound import Notice, TimeSyncRequest
from gcs_coloc.core.reasons import DUPLICATE_ID_WORDING, CoreRefusal

_MAX_RANGE_CLOCKS = 16  # of one vehicle; chosen: bounds the table against a sender of random device ids
_SILENT_AFTER_S = 30.0  # chosen: a device that is out of range of all others for some seconds keeps its clock
_PROVEN_AFTER_S = 60.0  # chosen: over so long the least delay of a clock is learnt
_OTHER_ROUTE_SHARE = 0.5  # of the delay, 1-sigma: a range may come by another route than the position
_FIX_AGE_S, _FIX_AGE_SIGMA_S = 0.1, 0.1  # when an autopilot stamps it; 0.11 s on ArduPlane
_FIX_DELAY_S, _FIX_DELAY_SIGMA_S = 0.25, 0.25  # age and link together, where there is no stamp
_LONGEST_FIX_AGE_S = 2.0  # beyond, the stamp is another clock's, as some autopilots and simulators put there

_WAITED_S = 20.0  # for answers to TIMESYNC, after a vehicle was first heard

_REFUSALS = {
    GlobalPosition: (CoreRefusal.POSITION_CLOCK_JUMPED, CoreRefusal.POSITION_TOO_OLD),
    Pressure: (CoreRefusal.PRESSURE_CLOCK_JUMPED, CoreRefusal.PRESSURE_TOO_OLD),
    Attitude: (CoreRefusal.ATTITUDE_CLOCK_JUMPED, CoreRefusal.ATTITUDE_TOO_OLD),
    SystemTime: (CoreRefusal.SYSTEM_TIME_CLOCK_JUMPED, CoreRefusal.SYSTEM_TIME_TOO_OLD),
}


@dataclass(slots=True)
class _RangeClock:
    """The clock of one ranging device, and when the device was last heard (service time, s)."""

    clock: SenderClock
    heard_at_s: float

    @property
    def is_proven(self) -> bool:
        """Whether the clock has run for some time."""
        return self.heard_at_s - self.clock.began_at_s >= _PROVEN_AFTER_S


@dataclass(slots=True)
class _Clocks:
    boot: VehicleClock
    ranging: dict[tuple[TimeBase, int], _RangeClock] = field(default_factory=dict)
    utc_minus_service_s: float | None = None
    unanswered_reported: set[str] = field(default_factory=set)
    has_duplicate_id: bool = False


class FleetClocks:
    """The clocks of vehicles and their ranging devices; `refused` counts refused stamps and answers."""

    def __init__(self, settings: TimeSettings | None = None, max_age_s: float = 5.0) -> None:
        """Begin without vehicles. `max_age_s`: a message that was measured longer ago than this is refused."""
        self.settings = settings if settings is not None else TimeSettings()
        self.refused: Counter[CoreRefusal] = Counter()
        self._max_age_s = max_age_s
        self._clocks: dict[int, _Clocks] = {}
        self.host_lag_s = 0.0
        self._utc = Utc(required=self.settings.require_synchronised_clock)

    def boot_clock(self, sysid: int) -> VehicleClock:
        """Return the boot clock of a vehicle's autopilot."""
        return self._of(sysid).boot

    def forget(self, sysid: int) -> None:
        """Forget the clocks of a vehicle that makes room for another one."""
        self._clocks.pop(sysid, None)

    def set_host_clock(self, message: ClockReference) -> list[Notice]:
        """Set what the host says of its clock; return notices for the operator."""
        self.host_lag_s = message.lag_s
        return self._utc.update(message)

    def host_fault(self) -> HostClockFault | None:
        """Return why the host's clock allows no aiding message; None where it does."""
        return self._utc.fault()

    def stamp(self, message: GlobalPosition | Pressure | Attitude | SystemTime) -> ServiceTime | None:
        """Add the boot time of a message; return when it was measured, None where its stamp is refused."""
        clock = self._of(message.sysid).boot
        jumped, too_old = _REFUSALS[type(message)]
        if not clock.learn(message.boot_s, message.received_at_s):
            self.refused[jumped] += 1
            return None
        return self._fresh(clock.to_service(message.boot_s, message.received_at_s), message.received_at_s, too_old)

    def booted_at_s(self, message: GlobalPosition, measured: ServiceTime) -> float:
        """Return the service time at which an autopilot booted; `measured` is that of the stamp in `message`."""
        return measured.at_s - self._of(message.sysid).boot.stamps.unwrapped(message.boot_s)

    def fix_time(self, message: GpsReceiver) -> ServiceTime:
        """Return when the fix of a receiver was measured."""
        now_s, clock = message.received_at_s, self._of(message.sysid).boot
        if message.fixed_boot_s is not None and clock.stamps.known:
            stamped = clock.to_service(message.fixed_boot_s, now_s)
            if 0.0 <= now_s + 3.0 * stamped.sigma_s - stamped.at_s <= _LONGEST_FIX_AGE_S:
                return ServiceTime(stamped.at_s - _FIX_AGE_S, hypot(stamped.sigma_s, _FIX_AGE_SIGMA_S))
        return ServiceTime(now_s - _FIX_DELAY_S, _FIX_DELAY_SIGMA_S)

    def range_time(self, message: PeerRange, position_delay_s: float | None) -> ServiceTime | None:
        """Return when a range was measured, None where its stamp is refused.

        `position_delay_s`: the delay of the vehicle's newest position, for a range without a stamp.
        """
        now_s = message.received_at_s
        if message.measured_at_s is None:
            # Delayed as much as the position, or by another route: from not at all to twice as much.
            delay_s = max(position_delay_s or 0.0, 0.0)
            sigma_s = hypot(self.settings.min_delay_sigma_s, _OTHER_ROUTE_SHARE * delay_s)
            return self._fresh(ServiceTime(now_s - delay_s, sigma_s), now_s, CoreRefusal.RANGE_TOO_OLD)
        if message.time_base is TimeBase.SERVICE:
            return self._fresh(ServiceTime(message.measured_at_s, 0.0), now_s, CoreRefusal.RANGE_TOO_OLD)
        # A ranging device or companion computer may have booted apart from the autopilot.
        clocks, key = self._of(message.sysid), (message.time_base, message.device_id)
        device = clocks.ranging.get(key)
        if device is None:
            if not _has_room(clocks.ranging, now_s):
                self.refused[CoreRefusal.RANGE_CLOCKS_FULL] += 1
                return None
            device = clocks.ranging[key] = _RangeClock(SenderClock(), now_s)
        device.heard_at_s = now_s
        if not device.clock.learn(message.measured_at_s, now_s):
            self.refused[CoreRefusal.RANGE_CLOCK_JUMPED] += 1
            return None
        measured = clocks.boot.device_to_service(device.clock, message.measured_at_s, now_s)
        return self._fresh(measured, now_s, CoreRefusal.RANGE_TOO_OLD)

    def add_system_time(self, message: SystemTime, *, gps_is_trusted: bool) -> None:
        """Add the boot time and the UTC of a vehicle.

        The UTC shows how late the vehicle's link is, where its GPS is trusted and the host knows UTC.
        """
        clocks, measured = self._of(message.sysid), self.stamp(message)
        if message.unix_s is None or measured is None:
            clocks.utc_minus_service_s = None
            return
        host_s = self._utc.synchronised_host_s()
        if host_s is not None and gps_is_trusted:
            clocks.boot.add_utc(message.unix_s, message.boot_s, host_s)
        clocks.utc_minus_service_s = message.unix_s - measured.at_s

    def utc_minus_service_s(self, with_healthy_gps: Iterable[int]) -> float | None:
        """Return UTC minus service clock, in s; None where neither host nor vehicles know UTC.

        The vehicles' UTC counts where the host's is missing, or its clock is known not to be synchronised.
        """
        stated_s = (self._of(sysid).utc_minus_service_s for sysid in with_healthy_gps)
        return self._utc.minus_service_s(utc_s for utc_s in stated_s if utc_s is not None)

    def add_answer(self, message: TimeSyncAnswer) -> None:
        """Add an answer to TIMESYNC."""
        refusal = self._of(message.sysid).boot.add_answer(message.ts1_ns, message.tc1_ns / 1e9, message.received_at_s)
        if refusal is not None:
            self.refused[refusal] += 1

    def request(self, sysid: int, now_s: float) -> TimeSyncRequest | None:
        """Return the TIMESYNC request that is due to a vehicle, None where none is."""
        ts1_ns = self._of(sysid).boot.round_trips.request(sysid, now_s, self.settings.timesync_period_s)
        return TimeSyncRequest(sysid, ts1_ns) if ts1_ns is not None else None

    def report_unanswered(self, sysid: int, first_heard_s: float, now_s: float) -> Notice | None:
        """Return a notice about a vehicle that does not answer TIMESYNC; None where none is due.

        It says how late the link is assumed to be. The operator gets it once for each method by which the clock is known
        instead, and again where TIMESYNC was answered and then is not answered any more.
        """
        clocks = self._of(sysid)
        since_s = max(first_heard_s, clocks.boot.stamps.began_at_s)
        if now_s - since_s < _WAITED_S or not clocks.boot.stamps.known or self.settings.min_delay_s > 0.0:
            return None
        if clocks.boot.synchronised(now_s) is not None:
            clocks.unanswered_reported.clear()
            return None
        one_way = clocks.boot.one_way()
        if one_way.method in clocks.unanswered_reported:
            return None
        clocks.unanswered_reported.add(one_way.method)
        held = f"{one_way.delay_s:.2f} s late, give or take {one_way.sigma_s:.2f} s"
        if one_way.method == "UTC":
            return Notice(now_s, sysid, "info", f"it does not answer TIMESYNC: by its UTC its link is {held}")
        text = (
            f"it does not answer TIMESYNC, and nothing else shows how late its link is: held to be {held}. Beyond that it is off "
            "along its course unseen, 2 m for each 0.1 s at 20 m/s; set min_delay_s and min_delay_sigma_s where you know them"
        )
        return Notice(now_s, sysid, "warning", text)

    def review_duplicate_id(self, sysid: int, now_s: float) -> Notice | None:
        """Review whether two autopilots use one system id; return a notice where that has changed."""
        clocks = self._of(sysid)
        before, clocks.has_duplicate_id = clocks.has_duplicate_id, clocks.boot.duplicates.detected(now_s)
        if clocks.has_duplicate_id == before:
            return None
        if clocks.has_duplicate_id:
            text = f"{DUPLICATE_ID_WORDING}; nothing is sent to them, and no position of theirs is used"
            return Notice(now_s, sysid, "error", text)
        return Notice(now_s, sysid, "info", "only one autopilot uses its system id any more")

    def has_duplicate_id(self, sysid: int) -> bool:
        """Return whether two autopilots used one system id at the last review."""
        return self._of(sysid).has_duplicate_id

    def knows_delay(self, sysid: int, now_s: float) -> bool:
        """Return whether it is shown how late a vehicle's link is; also true before its first stamp."""
        quality = self.boot_clock(sysid).quality(now_s)
        return quality is None or quality[0] != ONE_WAY or self.settings.min_delay_s > 0.0

    def _of(self, sysid: int) -> _Clocks:
        clocks = self._clocks.get(sysid)
        if clocks is None:
            clocks = self._clocks[sysid] = _Clocks(VehicleClock(self.settings))
        return clocks

    def _fresh(self, measured: ServiceTime, received_at_s: float, too_old: CoreRefusal) -> ServiceTime | None:
        if received_at_s - measured.at_s > self._max_age_s:
            self.refused[too_old] += 1
            return None
        return measured


def _has_room(ranging: dict[tuple[TimeBase, int], _RangeClock], now_s: float) -> bool:
    """Return whether there is room for one more device, made by a silent one, unproven ones first."""
    if len(ranging) < _MAX_RANGE_CLOCKS:
        return True
    silent = [key for key, device in ranging.items() if now_s - device.heard_at_s >= _SILENT_AFTER_S]
    if not silent:
        return False
    del ranging[min(silent, key=lambda key: (ranging[key].is_proven, ranging[key].heard_at_s))]
    return True
