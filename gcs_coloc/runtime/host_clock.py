"""The host's own time, and whether it can be trusted. Read by the composition root alone."""

from __future__ import annotations

import ctypes
import time

from gcs_coloc.core.messages.control import ClockReference

_TIMEX_BYTES = 512  # struct timex has 208 on 64-bit Linux; its first field, modes, 0 means: only read
_TIME_ERROR = 5
_EARLIEST_PLAUSIBLE_UNIX_S = 1_704_067_200.0  # 2024-01-01: a host that says less has no clock battery and no time yet


def read_host_clock(now_s: float) -> ClockReference:
    """How far the host's UNIX time is ahead of the service's at service time `now_s`, and whether it is kept right."""
    unix_s = time.time()
    return ClockReference(now_s, unix_s - now_s if unix_s >= _EARLIEST_PLAUSIBLE_UNIX_S else None, is_synchronised())


def is_synchronised() -> bool | None:
    """Whether something (NTP, PTP, a GPS receiver) keeps the host's clock right; None where the system does not tell.

    Source: adjtimex(2), which returns TIME_ERROR while the clock is not synchronised.
    """
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):
        return None
    state = int(adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)))
    return state != _TIME_ERROR if state >= 0 else None
