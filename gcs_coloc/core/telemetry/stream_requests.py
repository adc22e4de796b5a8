"""Requests for the streams that the service needs: only what is missing, and ever less often.

What few autopilots know yet is requested once, with the others: most refuse it, and that is no lack.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.messages.outbound import Stream, StreamRequest

_OF_ALL_HZ = {
    Stream.POSITION: 10.0,
    Stream.FIRST_RECEIVER: 5.0,
    Stream.ATTITUDE: 10.0,
    Stream.AIRSPEED: 5.0,
    Stream.SYSTEM_HEALTH: 2.0,
    Stream.SYSTEM_TIME: 1.0,
    Stream.PRESSURE: 5.0,
}
_OF_ARDUPILOT_HZ = {Stream.SECOND_RECEIVER: 5.0, Stream.EKF_STATUS: 2.0}
_OF_PX4_HZ = {Stream.ESTIMATOR_STATUS: 2.0}
_OF_WINGED_HZ = {Stream.VTOL_STATE: 2.0}
"""Of planes: many of them are VTOLs, and ArduPilot's tell it nowhere else."""
_WHERE_KNOWN_HZ = {Stream.RECEIVER_INTEGRITY: 1.0}
_WINDOW_S = 4.0  # chosen: four messages of the slowest stream
_FIRST_RETRY_S = 8.0  # chosen: two windows, so that what was requested has had one of its own
_LONGEST_RETRY_S = 120.0  # chosen: what is refused for good costs a radio one request in two minutes


def wanted_hz(autopilot: Autopilot | None) -> Mapping[Stream, float]:
    """The rates wanted of an autopilot: twice the lowest that serve; half of them is taken as enough.

    Each autopilot reports its filter in a message of its own and refuses the other's. PX4 has no GPS2_RAW.
    """
    if autopilot is Autopilot.ARDUPILOT:
        return _OF_ALL_HZ | _OF_ARDUPILOT_HZ
    return _OF_ALL_HZ | _OF_PX4_HZ if autopilot is Autopilot.PX4 else _OF_ALL_HZ


class HeardStreams(NamedTuple):
    """What a vehicle has sent since it was first heard, each stream counted."""

    sysid: int
    autopilot: Autopilot | None
    counts: Mapping[Stream, int]
    winged: bool = False


@dataclass(slots=True)
class _Window:
    began_s: float
    counts: Mapping[Stream, int]
    wait_s: float = _FIRST_RETRY_S
    asked_where_known: bool = False
    not_before_s: float = float("-inf")


class StreamRequests:
    """Asks for what a vehicle has sent over a window at less than half of the wanted rate."""

    def __init__(self) -> None:
        self._windows: dict[int, _Window] = {}

    def forget(self, sysid: int) -> None:
        """Forget the requests to a vehicle that has rebooted: it has forgotten them, too."""
        self._windows.pop(sysid, None)

    def due(self, now_s: float, vehicles: Iterable[HeardStreams]) -> list[StreamRequest]:
        """Return the requests that are due by now."""
        out: list[StreamRequest] = []
        for vehicle in vehicles:
            window = self._windows.get(vehicle.sysid)
            if window is None:
                self._windows[vehicle.sysid] = _Window(now_s, Counter(vehicle.counts))
                continue
            span_s = now_s - window.began_s
            if span_s < _WINDOW_S:
                continue
            wanted = wanted_hz(vehicle.autopilot)
            if vehicle.winged:
                wanted = {**wanted, **_OF_WINGED_HZ}
            missing = [
                stream
                for stream, hz in wanted.items()
                if vehicle.counts.get(stream, 0) - window.counts.get(stream, 0) < 0.5 * hz * span_s
            ]
            window.began_s, window.counts = now_s, Counter(vehicle.counts)
            if not window.asked_where_known:
                window.asked_where_known = True
                unheard = (stream for stream in _WHERE_KNOWN_HZ if not vehicle.counts.get(stream, 0))
                out.extend(StreamRequest(vehicle.sysid, stream, round(1e6 / _WHERE_KNOWN_HZ[stream])) for stream in unheard)
            if not missing:
                window.wait_s = _FIRST_RETRY_S
            elif now_s >= window.not_before_s:
                out.extend(StreamRequest(vehicle.sysid, stream, round(1e6 / wanted[stream])) for stream in missing)
                window.not_before_s = now_s + window.wait_s
                window.wait_s = min(2.0 * window.wait_s, _LONGEST_RETRY_S)
        return out
