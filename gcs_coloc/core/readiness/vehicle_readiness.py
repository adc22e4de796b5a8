"""The readiness of one vehicle: would it be located if its GPS failed, and what limits that?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason
from gcs_coloc.core.measurements import AMBIGUOUS, Estimate, NoEstimate, Vector3
from gcs_coloc.core.reasons import StatedReason, WordedReason
from gcs_coloc.core.stations.node_id import node_names

HORIZON_S = 30.0
"""So far ahead a loss is predicted. Chosen: time to take a vehicle over, or to bring a peer into a better place."""
IN_LINE_HDOP = 5.0
"""Chosen: from here on the peers count as in one line with the vehicle: the error is five times that of a range and more."""


class ReadinessState(StrEnum):
    """Whether a healthy vehicle would be located without GPS. The value stands in messages and recordings."""

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
    """The readiness of a vehicle: what would be if its GPS had failed at `at_s` (service time, s).

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


class LimitingReason(WordedReason):
    """Why there would be no fix, or only a coarse one, worded here alone."""

    NO_PEER = "no_peer", "no peer ranged"
    ONE_PEER = "one_peer", "one peer ranged: {detail}"
    IN_LINE = "in_line", "peers {detail} in one line with it: HDOP {value:.0f}"
    AMBIGUOUS = "ambiguous", "a position on the other side of peers {detail} fits the ranges as well"
    BEYOND_ALERT_LIMIT = "beyond_alert_limit", "protection level {value:.0f} m, beyond the alert limit of {limit:g} m"
    NOT_TESTED = "not_tested", "the ranges cannot test {detail}"
    NO_ESTIMATE = "no_estimate", "{detail}"
    NOT_AIDED = "not_aided", "it could not be aided: {detail}"
    NOT_PREDICTED = "not_predicted", "the estimator {detail} predicts no loss of GPS"
    OTHER = "other", "{detail}"


Limit = StatedReason[LimitingReason]
"""What limits the location of a vehicle, with the numbers of it."""


def limiting_reason(inhibit: Inhibit | None, answer: Estimate | NoEstimate, hdop: float, ranged: Sequence[int]) -> Limit | None:
    """Return what limits a vehicle that ranges some nodes; None where it has a fix.

    `inhibit` is why no fix is stated of the estimator's `answer`, `hdop` the horizontal dilution of the ranges. The geometry is
    named where it is the cause.
    """
    if inhibit is None:
        return None
    if not ranged:
        return Limit(LimitingReason.NO_PEER)
    names = node_names(ranged)
    if len(ranged) == 1:
        return Limit(LimitingReason.ONE_PEER, detail=names)
    if hdop >= IN_LINE_HDOP:
        return Limit(LimitingReason.IN_LINE, min(hdop, 999.0), detail=names)
    match inhibit.reason:
        case InhibitReason.BEYOND_ALERT_LIMIT:
            return Limit(LimitingReason.BEYOND_ALERT_LIMIT, inhibit.value, inhibit.limit)
        case InhibitReason.UNTESTED:
            return Limit(LimitingReason.NOT_TESTED, detail=inhibit.detail)
        case InhibitReason.NO_ESTIMATE:
            if isinstance(answer, NoEstimate) and answer.reason.reason in AMBIGUOUS:
                return Limit(LimitingReason.AMBIGUOUS, detail=names)
            return Limit(LimitingReason.NO_ESTIMATE, detail=inhibit.detail)
    return Limit(LimitingReason.OTHER, detail=inhibit.text)


def unit_vectors(here: Vector3, peers: Mapping[int, Vector3], max_range_m: float) -> dict[int, Vector3]:
    """Return the unit vectors from the peers in range to a vehicle, by node."""
    units: dict[int, Vector3] = {}
    for node, (e, n, u) in sorted(peers.items()):
        de, dn, du = here[0] - e, here[1] - n, here[2] - u
        length = math.sqrt(de * de + dn * dn + du * du)
        if 0.01 < length <= max_range_m:
            units[node] = (de / length, dn / length, du / length)
    return units
