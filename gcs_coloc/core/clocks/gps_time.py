"""UNIX time to GPS week and time of week.

GPS time does not know leap seconds: it runs ahead of UTC by as many as have been inserted since 1980-01-06. The table
is IERS Bulletin C's; one line is added when a bulletin announces a leap second, and `TABLE_GOOD_UNTIL` is moved on with
each bulletin.
"""

from __future__ import annotations

from bisect import bisect_right
from datetime import UTC, datetime

_GPS_EPOCH_UNIX_S = int(datetime(1980, 1, 6, tzinfo=UTC).timestamp())
_WEEK_MS = 7 * 86400 * 1000

# (UTC date from which it holds, GPS minus UTC in seconds); a date before the first entry is refused.
_LEAP_SECONDS = ((datetime(2015, 7, 1, tzinfo=UTC), 17), (datetime(2017, 1, 1, tzinfo=UTC), 18))
_STEPS_UNIX_S = tuple(int(since.timestamp()) for since, _ in _LEAP_SECONDS)

TABLE_GOOD_UNTIL = datetime(2027, 6, 28, tzinfo=UTC)
"""The bulletins read so far rule out another leap second before this date."""


def table_is_old(unix_s: float) -> bool:
    """Whether the leap second table no longer vouches for this time: an aid may then carry a time that is a second off."""
    return unix_s >= TABLE_GOOD_UNTIL.timestamp()


def gps_week_and_ms(unix_s: float) -> tuple[int, int]:
    """GPS week number and milliseconds into it of a UNIX time; (0, 0) where the time is before the table begins."""
    index = bisect_right(_STEPS_UNIX_S, unix_s)
    if index == 0:
        return 0, 0
    gps_ms = round((unix_s - _GPS_EPOCH_UNIX_S + _LEAP_SECONDS[index - 1][1]) * 1000.0)
    return divmod(gps_ms, _WEEK_MS)
