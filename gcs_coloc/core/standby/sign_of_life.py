"""The sign of life of the two services of one fleet, and what it tells of the other service.

Also here: the states of a service, why it is in one, and what an operator may order. All that is known of the other service, its
state, its silence, and whether it answers us, is from its signs of life.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
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


FRESH_S = 0.5
"""An answer to a message of ours that is older than this counts for nothing. Chosen: far more than a LAN takes."""
PRESENT_S = 1.0
"""Chosen: ten signs of life missed are a fault to be told of, fewer may be the network."""
_KEPT_SIGNS = 100  # chosen: the signs of ten seconds, of which only those of the last `FRESH_S` can be answered in time


class Heard(Enum):
    """What a sign of life is worth."""

    NOTHING = "nothing"
    STATE = "state"
    """It tells the other one's state; it may be late, or not know of us yet."""
    ANSWER = "answer"
    """It tells the state, and answers what we sent a moment ago."""


class OtherService:
    """What is known of the other service, from its signs of life.

    `run` is the random number of our own start. Times are service time, s.

    `shared` is what the other service told while it was active. `identity`, `state` and `heard_at_s` are None until it was
    heard. `since_s` is the time since which it has been in its state. `listening_since_s` is the time since which we have
    listened without standing still. `fresh_at_s` is when we sent the newest message that it has answered: the answer is no
    older than that. `echo` is run and number of its newest message. `mismatch` says in words why the two cannot be a pair.
    """

    def __init__(self, own: Identity, run: int, now_s: float) -> None:
        self.shared = NOTHING_SHARED
        self.identity: Identity | None = None
        self.state: StandbyState | None = None
        self.since_s = now_s
        self.heard_at_s: float | None = None
        self.fresh_at_s = float("-inf")
        self.echo = (0, 0)
        self.mismatch: str | None = None
        self.listening_since_s = now_s
        self._own = own
        self._run = run
        self._heard: SignOfLife | None = None
        self._sent_at_s: dict[int, float] = {}

    def add_sent(self, number: int, now_s: float) -> None:
        """Remember when a sign of life of ours was sent, to know how old an answer to it is."""
        self._sent_at_s[number] = now_s
        self._sent_at_s.pop(number - _KEPT_SIGNS, None)

    def listen_anew(self, now_s: float) -> None:
        """Forget how long it was silent: we have not listened until now."""
        self.listening_since_s = now_s

    def receive(self, sign: SignOfLife, now_s: float) -> Heard:
        """Receive a sign of life; return what it is worth."""
        if sign.sender.sysid != self._own.sysid or sign.sender.compid == self._own.compid:
            self.mismatch = _mismatch(self._own, sign.sender)
            return Heard.NOTHING
        self.mismatch = None
        last = self._heard
        is_same_run = last is not None and sign.run == last.run
        if last is not None and is_same_run and sign.number <= last.number:
            return Heard.NOTHING  # overtaken, or played back
        self.echo = (sign.run, sign.number)
        if sign.heard_run != self._run and not is_same_run:
            return Heard.NOTHING  # a start that has not heard us yet, or a recording: it is answered, and no more
        if not is_same_run or sign.state is not self.state:
            self.since_s = now_s
        self._heard, self.heard_at_s = sign, now_s
        self.identity, self.state = sign.sender, sign.state
        if sign.state is StandbyState.ACTIVE:
            self.shared = sign.shared
        answered_at_s = self._sent_at_s.get(sign.heard_number) if sign.heard_run == self._run else None
        if answered_at_s is None or now_s - answered_at_s > FRESH_S:
            return Heard.STATE
        self.fresh_at_s = max(self.fresh_at_s, answered_at_s)
        return Heard.ANSWER

    @property
    def silent_since_s(self) -> float:
        """Since when it has been silent while we were listening."""
        return max(self.heard_at_s if self.heard_at_s is not None else float("-inf"), self.listening_since_s)

    def is_present(self, now_s: float) -> bool:
        """Return whether it gives signs of life."""
        return self.heard_at_s is not None and now_s - self.heard_at_s <= PRESENT_S

    def is_known_to_follow(self, now_s: float) -> bool:
        """Return whether the other service says, in answer to us, that it does not send."""
        return self.state is not None and self.state not in SENDS_OR_MAY and now_s - self.fresh_at_s <= FRESH_S

    @property
    def lets_us_go_first(self) -> bool:
        """Whether we go first where both services could: the one with the lower component id does."""
        return self.identity is None or self._own < self.identity


def _mismatch(own: Identity, other: Identity) -> str:
    if own == other:
        return (
            f"both services send as system {own.sysid}, component {own.compid}: nobody can tell them apart. Set another "
            "mavlink.component_id on one of them, as 192"
        )
    return f"the other service sends as system {other.sysid}, this one as {own.sysid}: set the same mavlink.system_id on both"
