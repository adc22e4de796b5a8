"""Which vehicles may be fed while the other service of a hot standby is silent."""

from __future__ import annotations

from collections.abc import Collection

from gcs_coloc.core.standby.feed_watch import FeedWatch
from gcs_coloc.core.standby.other_service import PRESENT_S, OtherService

_LISTEN_S = 0.5
"""While the other one is silent a vehicle is watched for so long before it is fed anew. Chosen: five fixes of the other's."""
_WANTED_S = 1.0
"""A vehicle that needs aid and is fed by nobody, before a standby takes over for it: twice as long as an active one waits."""
_SENT_LATELY_S = 1.0
"""Chosen: a vehicle that we fed so lately nobody else has begun to feed."""


class FeedPermits:
    """The vehicles that need aid, those that a take-over was for, and those that we have fed of late."""

    def __init__(self, watch: FeedWatch, other: OtherService) -> None:
        self._watch = watch
        self._other = other
        self._wanted_since_s: dict[int, float] = {}
        self._granted: set[int] = set()
        self._sent_at_s: dict[int, float] = {}

    def set_wanted(self, wanted: Collection[int], now_s: float) -> None:
        """Take the vehicles that this service would send something that changes what they do."""
        self._wanted_since_s = {sysid: self._wanted_since_s.get(sysid, now_s) for sysid in wanted}
        self._granted &= self._wanted_since_s.keys()

    def grant(self, sysids: Collection[int]) -> None:
        """Let these vehicles, and no others, be fed at once."""
        self._granted = set(sysids)

    def add_fed(self, sysid: int, now_s: float) -> None:
        """Note that a vehicle is sent something that changes what it does."""
        self._sent_at_s[sysid] = now_s
        self._watch.add_sent(sysid, now_s)

    def fed_lately(self, now_s: float) -> tuple[int, ...]:
        """Return the vehicles that we have fed of late."""
        return tuple(sorted(sysid for sysid, at_s in self._sent_at_s.items() if now_s - at_s <= _SENT_LATELY_S))

    def free(self, now_s: float) -> set[int]:
        """Return the vehicles that need aid and show that nobody feeds them."""
        return {sysid for sysid in self._wanted_since_s if self._is_free(sysid, now_s)}

    def unknown(self, now_s: float) -> tuple[int, ...]:
        """Return the vehicles that have needed aid for a while and show nothing of who feeds them."""
        waiting = (sysid for sysid, since_s in self._wanted_since_s.items() if now_s - since_s >= _WANTED_S)
        return tuple(sorted(sysid for sysid in waiting if not self._watch.shows(sysid, now_s)))

    def may_feed_in_silence(self, sysid: int, now_s: float) -> bool:
        """Return whether a vehicle may be fed though nobody knows what the other one does."""
        if sysid in self._granted or now_s - self._sent_at_s.get(sysid, float("-inf")) <= _SENT_LATELY_S:
            return True
        wanted_since_s = self._wanted_since_s.get(sysid, now_s)
        since_s = max(wanted_since_s, self._other.listening_since_s, self._watch.fed_at_s(sysid, now_s))
        return now_s - since_s >= _LISTEN_S

    def _is_free(self, sysid: int, now_s: float) -> bool:
        """Whether a vehicle shows that nobody feeds it: at once where the other one did, else after a while."""
        if not self._watch.is_fed_no_more(sysid, now_s):
            return False
        was_fed = sysid in self._other.shared.feeding or now_s - self._watch.fed_at_s(sysid, now_s) <= PRESENT_S
        return was_fed or now_s - max(self._wanted_since_s[sysid], self._other.listening_since_s) >= _WANTED_S
