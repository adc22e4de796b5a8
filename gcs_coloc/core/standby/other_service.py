"""The other service of a hot standby: its state, its silence, and whether it answers us.

All of this is known from its signs of life.
"""

from __future__ import annotations

from enum import Enum

from gcs_coloc.core.standby.sign_of_life import NOTHING_SHARED, SENDS_OR_MAY, Identity, SignOfLife, StandbyState

FRESH_S = 0.5
"""An answer to a message of ours that is older than this counts for nothing. Chosen: far more than a LAN takes."""
PRESENT_S = 1.0
"""Chosen: ten signs of life missed are a fault to be told of, fewer may be the network."""
_KEPT_SIGNS = 100
"""Chosen: the signs of ten seconds, of which only those of the last `FRESH_S` can be answered in time."""


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
        """Whether we go first where both services could.

        The one with the lower component id does.
        """
        return self.identity is None or self._own < self.identity


def _mismatch(own: Identity, other: Identity) -> str:
    if own == other:
        return (
            f"both services send as system {own.sysid}, component {own.compid}: nobody can tell them apart. Set another "
            "mavlink.component_id on one of them, as 192"
        )
    return f"the other service sends as system {other.sysid}, this one as {own.sysid}: set the same mavlink.system_id on both"
