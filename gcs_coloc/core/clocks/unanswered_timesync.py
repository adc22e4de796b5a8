"""What the operator is told of vehicles that do not answer TIMESYNC: how late their links are held to be, and by what."""

from __future__ import annotations

from collections import defaultdict

from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings, VehicleClock

_WAITED_S = 20.0  # for answers, after a vehicle was first heard


class UnansweredTimesync:
    """Tells once of each vehicle by what its clock is known instead, and anew after TIMESYNC was answered and is no more."""

    def __init__(self, settings: TimeSettings) -> None:
        self._settings = settings
        self._reported: defaultdict[int, set[str]] = defaultdict(set)

    def report(self, sysid: int, clock: VehicleClock, first_heard_s: float, now_s: float) -> tuple[str, str] | None:
        """Level and text of what is to be told of a vehicle at service time `now_s`; None: nothing."""
        if now_s - first_heard_s < _WAITED_S or not clock.stamps.known or self._settings.min_delay_s > 0.0:
            return None
        if clock.synchronised(now_s) is not None:
            self._reported.pop(sysid, None)
            return None
        one_way = clock.one_way(self._settings)
        if one_way.method in self._reported[sysid]:
            return None
        self._reported[sysid].add(one_way.method)
        held = f"{one_way.delay_s:.2f} s late, give or take {one_way.sigma_s:.2f} s"
        if one_way.method == "UTC":
            return "info", f"it does not answer TIMESYNC: by its UTC its link is {held}"
        text = (
            f"it does not answer TIMESYNC, and nothing else shows how late its link is: held to be {held}. Beyond that it is off "
            "along its course unseen, 2 m for each 0.1 s at 20 m/s; set min_delay_s and min_delay_sigma_s where you know them"
        )
        return "warning", text
