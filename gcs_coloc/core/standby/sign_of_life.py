"""The sign of life that the two services of one fleet send each other, and their states.

Also here: why a service is in its state, and what an operator may order.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from gcs_coloc.core.messages.control import Override, SwitchedReceiver
from gcs_coloc.core.reasons import WordedReason


class Identity(NamedTuple):
    """The MAVLink system and component id with which a service sends. The component ids of the two differ."""

    sysid: int
    compid: int


class StandbyState(StrEnum):
    """What one of the two services does. Its value stands on the wire, in recordings and in MQTT messages."""

    LISTENING = "listening"
    """It has just started and listens whether the other one sends."""
    ACTIVE = "active"
    """It sends. No other state does."""
    HELD_UP = "held_up"
    """It was active, stood still for a moment, and finds out whether the other one has taken over."""
    STANDBY = "standby"
    """It follows, and takes over by itself."""
    PASSIVE = "passive"
    """It follows, and takes over only when it is told."""


SENDS_OR_MAY = (StandbyState.ACTIVE, StandbyState.HELD_UP, StandbyState.LISTENING)
"""The states that the other one must wait for: it sends, or is about to decide."""


class StandbyReason(WordedReason):
    """Why a service is in its state."""

    STARTED = "started", "it has started"
    ALONE_AT_START = "alone_at_start", "it is to be active from the start, and nobody else sent"
    TOOK_OVER = "took_over", "the other one gave no sign of life, and the vehicles were fed no more"
    NOBODY_SENT = "nobody_sent", "the other one does not send either"
    TOLD = "told", "an operator said so"
    RELEASED = "released", "the other one has let this one take over"
    GAVE_WAY = "gave_way", "it has let the other one take over"
    STOOD_STILL = "stood_still", "it stood still for {value:.2f} s, longer than the {limit:g} s after which it may not send"
    RESUMED = "resumed", "nobody took over while it stood still"
    OTHER_IS_ACTIVE = "other_is_active", "the other one is active"
    OTHER_FEEDS = "other_feeds", "the other one feeds vehicle {value:.0f}"


class Wish(StrEnum):
    """What a service wants of the other one."""

    NONE = ""
    REQUEST = "request"
    """Let me take over."""
    OFFER = "offer"
    """Take over from me: I have stopped sending."""


class StandbyOrder(StrEnum):
    """What an operator tells one of the two."""

    TAKE_OVER = "take_over"
    RELEASE = "release"
    STAND_BY = "stand_by"


class OrderRefusal(WordedReason):
    """Why an operator's order is not carried out."""

    ALREADY_ACTIVE = "already_active", "this service is active already"
    NOT_ACTIVE = "not_active", "this service is not active: there is nothing to take over"
    IS_DECIDING = "is_deciding", "this service is finding out whether the other one sends: try again in a second"
    NOBODY_TO_TAKE_OVER = "nobody_to_take_over", "the other service does not answer: it cannot take over"
    STILL_FED = (
        "still_fed",
        "the other service gives no sign of life, but vehicle {value:.0f} is still fed by it: end it there first",
    )
    SAME_IDENTITY = "same_identity", "{detail}"


class OverrideInForce(NamedTuple):
    """An operator's override of one vehicle that is not automatic."""

    sysid: int
    override: Override


@dataclass(frozen=True, slots=True)
class Shared:
    """What the active service tells the other one, so that the other one can take over.

    `feeding` are the vehicles that the active service feeds, `overrides` are the operators' overrides in force, `switched` are
    the vehicles whose own receiver the service has switched out of use.
    """

    feeding: tuple[int, ...] = ()
    overrides: tuple[OverrideInForce, ...] = ()
    switched: tuple[SwitchedReceiver, ...] = ()


NOTHING_SHARED = Shared()


@dataclass(frozen=True, slots=True)
class SignOfLife:
    """One sign of life: a message between the two services.

    `run` is drawn at random at each start, `number` counts the messages of it. `heard_run` and `heard_number` are those of the
    newest message that the sender has of the receiver: by them the receiver sees that this is no recording, and how old it may
    be. `term` counts the changes of who is active; the higher one is the newer.
    """

    sender: Identity
    run: int
    number: int
    heard_run: int
    heard_number: int
    state: StandbyState
    term: int
    wish: Wish = Wish.NONE
    shared: Shared = NOTHING_SHARED
