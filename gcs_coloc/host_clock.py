"""Whether the host's clock is disciplined, as the kernel sees it. Read by the composition root alone."""

from __future__ import annotations

import ctypes

_TIMEX_BYTES = 512  # struct timex has 208 on 64-bit Linux; its first field, modes, 0 means: only read
_TIME_ERROR = 5


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
