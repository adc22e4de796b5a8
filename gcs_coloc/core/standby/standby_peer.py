"""The state machine of a hot standby peer: it decides which of the two services sends.

With two services there is no majority. Three rules keep them from sending both, and hold in this order:

1. Who stood still for longer than `STILL_S` does not send before it knows that the other one has not taken over.
2. Nobody takes over by itself before the other one has been silent for `SILENT_S`, which is longer, and a vehicle has shown that
   it is fed no more. A vehicle that shows nothing of that is left to the operator.
3. Who took over by silence and then sees the other one's stream was wrong, and stands back.
"""

from __future__ import annotations

from collections.abc import Collection

from gcs_coloc.core.messages.control import SwitchedReceiver
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.standby.feed_watch import FeedWatch
from gcs_coloc.core.standby.sign_of_life import (
    FRESH_S,
    NOTHING_SHARED,
    PRESENT_S,
    SENDS_OR_MAY,
    Heard,
    Identity,
    OrderRefusal,
    OtherService,
    OverrideInForce,
    Shared,
    SignOfLife,
    StandbyOrder,
    StandbyReason,
    StandbyState,
    Wish,
)
from gcs_coloc.core.standby.standby_snapshot import ALONE_S, Stand, StandbySnapshot, standby_snapshot

SIGN_EVERY_S = 0.1
"""Ten signs of life a second."""
TICK_S = 0.05
"""Between two looks at the time. Chosen: half of a sign's period."""
STILL_S = 0.2
"""Who has stood still for longer may not send. Less than `SILENT_S`, so that it has ended before the other one begins."""
SILENT_S = 0.3
"""Chosen: three signs of life. With the next fix 0.1 s later a vehicle misses four fixes, less than 0.5 s."""
_START_S = 1.0  # chosen: ten signs of life; the one with the higher component id listens twice as long
_CHECK_S = 1.0  # how long who stood still waits for an answer. Longer than a take-over takes to show at a vehicle
_NOBODY_S = 1.5  # before one of two that both follow takes over. Longer than an offer holds (`_OFFER_S` and `FRESH_S`)
_OFFER_S = 0.4  # for so long the other one is offered to take over; chosen: four signs of life, so that one gets through
_REQUEST_S = 2.0  # for so long the other one is asked to give way; chosen: an operator waits no longer for an answer
_STOOD_BACK_S = 1.0  # chosen: the one that goes on has the time to show it; twice as long for the higher component id
_IN_FLIGHT_S = 0.1  # what was sent before a take-over may arrive so long after it; chosen: it was sent `SILENT_S` before
_JUST_AFTER_S = 1e-3  # chosen: far more than the clock's resolution


class StandbyPeer:
    """One of the two services of a hot standby.

    Call `tick` every `TICK_S` and `receive` for each sign of life, and add what vehicles show to `watch`.

    `own` is the identity with which it sends. `run` is a random number of this start. `is_active`: it is to be the active one
    from the start. `period_s` is the time between two fixes.
    """

    def __init__(self, own: Identity, run: int, *, is_active: bool, now_s: float, period_s: float) -> None:
        self.own = own
        self.state = StandbyState.LISTENING if is_active else StandbyState.STANDBY
        self.reason = StatedReason(StandbyReason.STARTED)
        self.since_s = now_s
        self.term = 0
        self._run = run
        self._other = OtherService(own, run, now_s)
        self.watch = FeedWatch(period_s, self._other)
        self._number = 0
        self._sign_due_s = now_s
        self._ticked_at_s = now_s
        self._resumes_after = 0
        self._took_over_silently = False
        self._stands_back_until_s = now_s
        self._wish_until_s = now_s
        self._waiting_for: tuple[int, ...] = ()

    # What comes in

    def receive(self, sign: SignOfLife, now_s: float) -> None:
        """Receive a sign of life whose sender has proven that it has the key."""
        self._look_at_time(now_s)
        heard = self._other.receive(sign, now_s)
        if heard is not Heard.NOTHING:
            self._follow(sign, now_s, answers_us=heard is Heard.ANSWER)

    def tick(self, now_s: float, wanted: Collection[int]) -> None:
        """Update the state as of now.

        `wanted` are the vehicles to which this service would send something that changes what they do.
        """
        self._look_at_time(now_s)
        self._ticked_at_s = now_s
        self.watch.set_wanted(wanted, now_s)
        self._waiting_for = ()
        match self.state:
            case StandbyState.LISTENING:
                self._listen(now_s)
            case StandbyState.ACTIVE:
                self._review_active(now_s)
            case StandbyState.HELD_UP:
                self._find_out(now_s)
            case StandbyState.STANDBY:
                self._consider(now_s)
            case StandbyState.PASSIVE:
                pass

    def next_tick_s(self, now_s: float) -> float:
        """Return when to look at the time next: after `TICK_S`, or as soon as the other one counts as silent."""
        if self.state is StandbyState.STANDBY and self._other.heard_at_s is not None:
            silent_at_s = self._other.silent_since_s + SILENT_S + _JUST_AFTER_S
            if now_s < silent_at_s < now_s + TICK_S:
                return silent_at_s
        return now_s + TICK_S

    def order(self, order: StandbyOrder, now_s: float) -> StatedReason[OrderRefusal] | None:
        """Carry out an order of the operator; return why it is refused, None where it is done."""
        self._look_at_time(now_s)
        if self.state in (StandbyState.LISTENING, StandbyState.HELD_UP):
            return StatedReason(OrderRefusal.IS_DECIDING)
        is_active = self.state is StandbyState.ACTIVE
        if order is StandbyOrder.RELEASE:
            return self._give_way(now_s) if is_active else StatedReason(OrderRefusal.NOT_ACTIVE)
        if is_active:
            return StatedReason(OrderRefusal.ALREADY_ACTIVE)
        if order is StandbyOrder.STAND_BY:
            self._enter(StandbyState.STANDBY, StatedReason(StandbyReason.TOLD), now_s)
            return None
        return self._take_over_as_told(now_s)

    @property
    def shared(self) -> Shared:
        """What the other one told while it was active."""
        return self._other.shared

    # What goes out

    def sign_is_due(self, now_s: float) -> bool:
        """Return whether the next sign of life is to be sent."""
        return now_s >= self._sign_due_s

    def sign_of_life(
        self, now_s: float, overrides: tuple[OverrideInForce, ...] = (), switched: tuple[SwitchedReceiver, ...] = ()
    ) -> SignOfLife:
        """Return the next sign of life, with what the other one must know of an active service."""
        self._look_at_time(now_s)
        self._sign_due_s = now_s + SIGN_EVERY_S
        self._number += 1
        self._other.add_sent(self._number, now_s)
        wish = Wish.NONE
        if now_s < self._wish_until_s:
            gave_away = self.reason.reason is StandbyReason.GAVE_WAY
            wish = Wish.OFFER if gave_away else Wish.REQUEST
        shared = NOTHING_SHARED
        if self.state is StandbyState.ACTIVE:
            shared = Shared(self.watch.fed_lately(now_s), overrides, switched)
        return SignOfLife(self.own, self._run, self._number, *self._other.echo, self.state, self.term, wish, shared)

    def may_send(self, sysid: int, now_s: float) -> bool:
        """Return whether a vehicle may be changed now; ask right before sending, as it then counts as fed."""
        self._look_at_time(now_s)
        if self.state is not StandbyState.ACTIVE:
            return False
        if not self._other.is_known_to_follow(now_s) and not self.watch.may_feed_in_silence(sysid, now_s):
            return False
        self.watch.add_fed(sysid, now_s)
        return True

    def follows(self, now_s: float) -> bool:
        """Return whether the other service is active and heard, so that `shared` is up to date."""
        return self.state is not StandbyState.ACTIVE and self.hears_other(now_s) and self._other.state is StandbyState.ACTIVE

    def may_be_other(self, sender: Identity) -> bool:
        """Return whether a sender is the other service; until that was heard, whether it may be."""
        if self._other.identity is not None:
            return sender == self._other.identity
        return sender.sysid == self.own.sysid and sender.compid != self.own.compid

    def hears_other(self, now_s: float) -> bool:
        """Return whether the other one gives signs of life."""
        return self._other.is_present(now_s)

    def other_stands_by(self, now_s: float) -> bool:
        """Return whether the other one would take over at once."""
        return now_s - self._other.silent_since_s <= SILENT_S and self._other.state is StandbyState.STANDBY

    def snapshot(self, now_s: float) -> StandbySnapshot:
        """Return the state of the hot standby, for observers."""
        fed_sysid = self.watch.fed_vehicle(now_s)
        stand = Stand(self.own, self.state, self.reason, self.since_s, self.term, fed_sysid, self._waiting_for)
        return standby_snapshot(stand, self._other, now_s)

    # The rules

    def _look_at_time(self, now_s: float) -> None:
        """Detect that the process stood still: it has then neither listened nor sent signs of life."""
        still_s = now_s - self._ticked_at_s
        if still_s <= STILL_S:
            return
        self._ticked_at_s = now_s
        self._other.listen_anew(now_s)
        self.watch.grant(())
        if self.state is StandbyState.ACTIVE:
            self._resumes_after = self._number
            self._sign_due_s = now_s
            self._enter(StandbyState.HELD_UP, StatedReason(StandbyReason.STOOD_STILL, still_s, STILL_S), now_s)
        elif self.state in (StandbyState.HELD_UP, StandbyState.LISTENING):
            # The time does not count; but a computer that is slow all the time must come to an end of it.
            self.since_s += still_s
            self._resumes_after = self._number

    def _follow(self, sign: SignOfLife, now_s: float, *, answers_us: bool) -> None:
        is_active = self.state is StandbyState.ACTIVE
        if sign.state is StandbyState.ACTIVE:
            mine_is_newer = (self.term, -self.own.compid) > (sign.term, -sign.sender.compid)
            if self.state in SENDS_OR_MAY and (not mine_is_newer or (not is_active and answers_us)):
                self._enter(StandbyState.PASSIVE, StatedReason(StandbyReason.OTHER_IS_ACTIVE), now_s)
            if self.state is not StandbyState.ACTIVE:
                self.term = max(self.term, sign.term)
            return
        self.term = max(self.term, sign.term)
        if sign.state is StandbyState.HELD_UP:
            self._sign_due_s = now_s  # it waits for our answer
            if self.state is StandbyState.LISTENING:
                self.since_s = now_s  # and will go on
        if not answers_us:
            return
        self._took_over_silently = False  # the other one knows of us and does not send
        if self.state is StandbyState.HELD_UP:
            # One that has just started has heard that we are here, and waits.
            if sign.state is not StandbyState.HELD_UP and sign.heard_number > self._resumes_after:
                self._enter(StandbyState.ACTIVE, StatedReason(StandbyReason.RESUMED), now_s)
        elif is_active and sign.wish is Wish.REQUEST:
            self._give_way(now_s)
        elif sign.wish is Wish.OFFER and self.state in (StandbyState.STANDBY, StandbyState.PASSIVE):
            self._become_active(StandbyReason.RELEASED, now_s)

    def _listen(self, now_s: float) -> None:
        fed = self.watch.fed_vehicle(now_s)
        if fed is not None:
            self._enter(StandbyState.PASSIVE, StatedReason(StandbyReason.OTHER_FEEDS, fed), now_s)
            return
        both_listen = now_s - self._other.silent_since_s <= SILENT_S and self._other.state is StandbyState.LISTENING
        has_heard = now_s - self._other.listening_since_s >= SILENT_S
        if has_heard and now_s - self.since_s >= _START_S * (2.0 if both_listen and not self._other.lets_us_go_first else 1.0):
            self._become_active(StandbyReason.ALONE_AT_START, now_s)

    def _review_active(self, now_s: float) -> None:
        """Return to standby where the other service is seen to feed though it was silent."""
        if not self._took_over_silently:
            return
        fed = self.watch.fed_vehicle(now_s, self.since_s + _IN_FLIGHT_S)
        if fed is None:
            return
        self._stands_back_until_s = now_s + _STOOD_BACK_S * (1.0 if self._other.lets_us_go_first else 2.0)
        self._enter(StandbyState.STANDBY, StatedReason(StandbyReason.OTHER_FEEDS, fed), now_s)

    def _find_out(self, now_s: float) -> None:
        fed = self.watch.fed_vehicle(now_s, self.since_s + SILENT_S)
        if fed is not None:
            self._enter(StandbyState.PASSIVE, StatedReason(StandbyReason.OTHER_FEEDS, fed), now_s)
        elif now_s - self.since_s >= _CHECK_S and now_s - self._other.listening_since_s >= FRESH_S:
            self._enter(StandbyState.ACTIVE, StatedReason(StandbyReason.RESUMED), now_s)

    def _consider(self, now_s: float) -> None:
        """Take over, where nobody sends."""
        if self._other.mismatch is not None or now_s < self._stands_back_until_s:
            return
        silent_s = now_s - self._other.silent_since_s
        if self._other.state is not None and silent_s <= SILENT_S:
            if self._other.state in SENDS_OR_MAY or now_s - self._other.fresh_at_s > SILENT_S:
                return
            both_follow_s = now_s - max(self.since_s, self._other.since_s)
            if both_follow_s >= _NOBODY_S + (0.0 if self._other.lets_us_go_first else _START_S):
                self._become_active(StandbyReason.NOBODY_SENT, now_s)
            return
        if silent_s <= (SILENT_S if self._other.state is not None else ALONE_S) or self.watch.fed_vehicle(now_s) is not None:
            return
        free = self.watch.free(now_s)
        if free:
            self._become_active(StandbyReason.TOOK_OVER, now_s)
            self.watch.grant(free)
            self._took_over_silently = True
        else:
            self._waiting_for = self.watch.unknown(now_s)

    def _take_over_as_told(self, now_s: float) -> StatedReason[OrderRefusal] | None:
        if self._other.mismatch is not None:
            return StatedReason(OrderRefusal.SAME_IDENTITY, detail=self._other.mismatch)
        if self._other.is_present(now_s):
            if self._other.state in SENDS_OR_MAY:
                self._wish_until_s, self._sign_due_s = now_s + _REQUEST_S, now_s
                self.reason = StatedReason(StandbyReason.TOLD)
                return None
        elif (fed := self.watch.fed_vehicle(now_s)) is not None:
            return StatedReason(OrderRefusal.STILL_FED, fed)
        self._become_active(StandbyReason.TOLD, now_s)
        return None

    def _give_way(self, now_s: float) -> StatedReason[OrderRefusal] | None:
        if self._other.state in (None, *SENDS_OR_MAY) or now_s - self._other.fresh_at_s > PRESENT_S:
            return StatedReason(OrderRefusal.NOBODY_TO_TAKE_OVER)
        self._enter(StandbyState.STANDBY, StatedReason(StandbyReason.GAVE_WAY), now_s)
        self._wish_until_s, self._sign_due_s = now_s + _OFFER_S, now_s
        return None

    def _become_active(self, why: StandbyReason, now_s: float) -> None:
        self.term += 1
        self._took_over_silently = False
        self.watch.grant(())
        self._enter(StandbyState.ACTIVE, StatedReason(why), now_s)

    def _enter(self, state: StandbyState, reason: StatedReason[StandbyReason], now_s: float) -> None:
        self.state, self.reason, self.since_s = state, reason, now_s
        self._wish_until_s = self._sign_due_s = now_s  # the other one is told at once
