"""Which of two services sends, as observers see it, and what a person should do."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.standby.sign_of_life import Identity, OtherService, StandbyReason, StandbyState

ALONE_S = 5.0
"""A standby that has never heard the other one takes over after so long. Chosen: both laptops are started within it."""


@dataclass(frozen=True, slots=True)
class StandbySnapshot:
    """Which of the two services sends, as observers see it.

    Times are service time, s, and ages are in s. None stands for never.

    `other_state` is None as well while the other one gives no sign of life: what it does then is not known.
    `sends`: `this`, `other`, `nobody` or `unknown`. `fed_sysid`: a vehicle that shows that the other one feeds it. `problem`:
    what a person should do, None where all is well. `waiting_for_sysids`: the vehicles that show nothing of who feeds them,
    for which the operator must take over.
    """

    own: str
    state: str
    reason: str
    since_s: float
    term: int
    sends: str
    other: str | None
    other_state: str | None
    other_age_s: float | None
    fed_sysid: int | None
    problem: str | None
    waiting_for_sysids: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Stand:
    """How one of the two services stands itself; its fields are those of `StandbySnapshot`."""

    own: Identity
    state: StandbyState
    reason: StatedReason[StandbyReason]
    since_s: float
    term: int
    fed_sysid: int | None
    waiting_for_sysids: tuple[int, ...]


def standby_snapshot(stand: Stand, other: OtherService, now_s: float) -> StandbySnapshot:
    """Return how a service stands beside the other one at service time `now_s`."""
    return StandbySnapshot(
        own=_name(stand.own),
        state=stand.state.value,
        reason=stand.reason.text,
        since_s=stand.since_s,
        term=stand.term,
        sends=_who_sends(stand, other, now_s),
        other=_name(other.identity) if other.identity is not None else None,
        other_state=other.state.value if other.state is not None and other.is_present(now_s) else None,
        other_age_s=now_s - other.heard_at_s if other.heard_at_s is not None else None,
        fed_sysid=stand.fed_sysid,
        problem=_problem(stand, other, now_s),
        waiting_for_sysids=stand.waiting_for_sysids,
    )


def _who_sends(stand: Stand, other: OtherService, now_s: float) -> str:
    if stand.state is StandbyState.ACTIVE:
        return "this"
    if stand.fed_sysid is not None:
        return "other"
    if not other.is_present(now_s):
        return "unknown"
    return "other" if other.state is StandbyState.ACTIVE else "nobody"


def _problem(stand: Stand, other: OtherService, now_s: float) -> str | None:
    if other.mismatch is not None:
        return other.mismatch
    if stand.waiting_for_sysids:
        names = ", ".join(map(str, stand.waiting_for_sysids))
        return (
            f"the other service is silent, and vehicle {names} shows neither GPS_INPUT nor GPS2_RAW, so that nobody can tell "
            "whether it is still fed: make sure that the other service has ended, then take over"
        )
    if not other.is_present(now_s):
        if now_s - stand.since_s <= ALONE_S and other.heard_at_s is None:
            return None
        is_fed = stand.fed_sysid is not None and stand.state is not StandbyState.ACTIVE
        seen = f", but feeds vehicle {stand.fed_sysid}" if is_fed else ""
        return f"the other service gives no sign of life{seen}"
    if stand.state is StandbyState.PASSIVE and other.state is not StandbyState.ACTIVE:
        return "neither service sends: take over with one of them"
    if other.state is StandbyState.PASSIVE:
        return "the other service follows, but does not take over by itself until it is told to stand by"
    return None


def _name(identity: Identity) -> str:
    return f"{identity.sysid}/{identity.compid}"
