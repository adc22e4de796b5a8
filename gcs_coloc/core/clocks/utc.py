"""UTC on the service's clock, and GPS time from it.

UTC is the host's. Where its clock is known not to be synchronised, that of the vehicles with healthy GPS comes first.

GPS time does not know leap seconds: it runs ahead of UTC by as many as have been inserted since 1980-01-06. The table
is IERS Bulletin C's; one line is added when a bulletin announces a leap second, and `TABLE_GOOD_UNTIL` is moved on with
each bulletin.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from datetime import UTC, datetime
from enum import Enum
from statistics import median

from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.messages.outbound import Notice

_GPS_EPOCH_UNIX_S = int(datetime(1980, 1, 6, tzinfo=UTC).timestamp())  # Source: IS-GPS-200, the start of GPS time
_WEEK_MS = 7 * 86400 * 1000  # a GPS week, in the unit of time_week_ms

# (UTC date from which it holds, GPS minus UTC in seconds); a date before the first entry is refused.
_LEAP_SECONDS = ((datetime(2015, 7, 1, tzinfo=UTC), 17), (datetime(2017, 1, 1, tzinfo=UTC), 18))
_STEPS_UNIX_S = tuple(int(since.timestamp()) for since, _ in _LEAP_SECONDS)

TABLE_GOOD_UNTIL = datetime(2027, 6, 28, tzinfo=UTC)
"""The bulletins read so far rule out another leap second before this date."""


def table_is_old(unix_s: float) -> bool:
    """Return whether a UNIX time is too late for the leap second table: GPS time may be a second off."""
    return unix_s >= TABLE_GOOD_UNTIL.timestamp()


def gps_week_and_ms(unix_s: float) -> tuple[int, int]:
    """Return GPS week and milliseconds into it of a UNIX time; (0, 0) before the leap second table begins."""
    index = bisect_right(_STEPS_UNIX_S, unix_s)
    if index == 0:
        return 0, 0
    gps_ms = round((unix_s - _GPS_EPOCH_UNIX_S + _LEAP_SECONDS[index - 1][1]) * 1000.0)
    return divmod(gps_ms, _WEEK_MS)


class HostClockFault(Enum):
    """Why the host's UTC is not good enough, where the settings require it; the value is the wording."""

    UNSYNCHRONISED = "the host's clock is not synchronised (NTP or the like)"
    UNKNOWN = "the host does not state whether its clock is synchronised"


class Utc:
    """UTC on the service's clock; `required`: nobody is aided while the host is not known synchronised."""

    def __init__(self, *, required: bool) -> None:
        self._required = required
        self._host: ClockReference | None = None
        self._warned_of_old_table = False

    def update(self, message: ClockReference) -> list[Notice]:
        """Update with what the host says of its clock; return a notice for each change."""
        before = self._host.synchronised if self._host is not None else None
        first, self._host = self._host is None, message
        out: list[Notice] = []
        if message.synchronised is not before or (first and self._required):
            out.extend(self._notices(message))
        offset_s = message.utc_minus_service_s
        if offset_s is not None and not self._warned_of_old_table and table_is_old(message.received_at_s + offset_s):
            self._warned_of_old_table = True
            text = f"the leap second table is good until {TABLE_GOOD_UNTIL:%Y-%m-%d} only: GPS time may be a second off, update"
            out.append(Notice(message.received_at_s, None, "warning", text))
        return out

    def fault(self) -> HostClockFault | None:
        """Return why no aiding message may be sent; None where it may."""
        if not self._required or (self._host is not None and self._host.synchronised):
            return None
        unsynchronised = self._host is not None and self._host.synchronised is False
        return HostClockFault.UNSYNCHRONISED if unsynchronised else HostClockFault.UNKNOWN

    def synchronised_host_s(self) -> float | None:
        """Return UTC minus service clock, in s, of a host whose clock is known to be right; else None."""
        return self._host.utc_minus_service_s if self._host is not None and self._host.synchronised else None

    def minus_service_s(self, of_vehicles_s: Iterable[float]) -> float | None:
        """Return UTC (UNIX seconds) minus service clock; None where neither host nor vehicles know it.

        `of_vehicles_s` is what vehicles with healthy GPS state. A host clock that is known not to be synchronised counts less
        than their median.
        """
        host_s = self._host.utc_minus_service_s if self._host is not None else None
        if host_s is not None and self._host is not None and self._host.synchronised is not False:
            return host_s
        stated_s = list(of_vehicles_s)
        return median(stated_s) if stated_s else host_s

    def _notices(self, message: ClockReference) -> list[Notice]:
        fault = self.fault()
        if message.synchronised:
            return [Notice(message.received_at_s, None, "info", "the host's clock is synchronised")]
        if fault is not None:
            return [Notice(message.received_at_s, None, "error", f"{fault.value}: nobody is aided, as it is set")]
        if message.synchronised is False:
            text = "the time in GPS_INPUT is the vehicles' where they know it, else it may be wrong"
            text = f"{HostClockFault.UNSYNCHRONISED.value}: {text}"
            return [Notice(message.received_at_s, None, "warning", text)]
        return []
