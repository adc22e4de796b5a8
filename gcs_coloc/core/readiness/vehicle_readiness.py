"""The readiness of one vehicle: its state, what limits it, and what it would have without GPS, now and half a minute later."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

HORIZON_S = 30.0
"""So far ahead a loss is predicted. Chosen: time to take a vehicle over, or to bring a peer into a better place."""


class ReadinessState(StrEnum):
    """Whether a healthy vehicle would be located if its GPS failed now. Its value stands in messages and recordings."""

    READY = "ready"
    """It would have a fix for the next half minute, and the ranges test every receiver that it rests on."""
    DEGRADED = "degraded"
    """It would have a fix, but with a weakness: one peer, peers in one line, or a receiver that nothing tests."""
    NOT_READY = "not_ready"
    """It would have no fix half a minute later."""
    UNKNOWN = "unknown"
    """It cannot be told."""


# Not frozen, as `VehicleSnapshot` is not: each page is sent all of them several times a second.
@dataclass(slots=True)
class VehicleReadiness:
    """What would be if the GPS of a vehicle had failed at `at_s` (service time, s).

    `reason` is the code of the `LimitingReason` and `text` that in words; None and empty for READY. `peers` counts the nodes
    that it ranges. Of the moment of the loss (`_now_`) and of half a minute later: the 95 % bound and the protection level HPL
    in m, and the HDOP of the ranges; None where there is none. `is_told`: the size of the later bound is told; else it is what
    the held motion gives. `is_lost`: it is in flight, was located otherwise, and is not ready.
    """

    state: ReadinessState
    at_s: float
    reason: str | None = None
    text: str = ""
    peers: int = 0
    bound_95_now_m: float | None = None
    bound_95_m: float | None = None
    hpl_now_m: float | None = None
    hpl_m: float | None = None
    hdop_now: float | None = None
    hdop: float | None = None
    is_told: bool = False
    is_lost: bool = False
