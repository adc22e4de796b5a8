"""What the links and the decoder have refused: totals for observers, and now and then a line for the operator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

# Part of every healthy day: other programs' messages, our own frames come back, radios that deliver twice.
_QUIET = frozenset({"not_wanted", "unknown_message", "echo", "duplicate", "unsigned_radio_status"})
# Counted and shown, but nothing to warn of: vehicles answer to every ground station that commands them.
_NOT_WARNED_OF = frozenset({"answer_to_another"})
_REMEDIES = {
    "garbage_bytes": "bytes that are no MAVLink: where nobody is heard on a serial link, a wrong baud rate",
    "address_conflict": "two senders use one system id: give every vehicle its own (SYSID_THISMAV or MAV_SYSID)",
    "unsigned": "a link that requires signatures: give the vehicle the key, or is somebody pretending?",
    "signature_wrong": "the vehicle has another key than ours, or somebody is pretending",
    "signature_replayed": "frames out of order, or somebody plays back what was recorded",
    "signature_old": "signed over a minute before our time: a vehicle that follows ours once it hears us, or a recording",
    "signature_future": "the vehicle's signing time is beyond 2100: its clock is wrong",
    "signature_streams_full": "more signed senders than there is room for",
    "not_sent": "the system does not send there: is there no way to it?",
    "output_skipped": "somebody on a serial or TCP link takes less than it is sent; the oldest was dropped",
    "ground_tool_unknown_sender": "only the ground tool at the address of `out` is listened to there",
    "too_many_ground_tools": "more ground tools on one port than there is room for",
    "ground_tool_unknown_target": "a ground tool speaks to a system that was never heard",
    "ground_tool_claims_vehicle": "a ground tool uses a vehicle's system id: give it its own (255 by custom)",
    "ground_tool_aid": "a ground tool sends positions to a vehicle that we aid: stop one of the two",
    "forward_address_conflict": "frames under a vehicle's system id from another address than its own are not handed on",
    "rate_limited": "more than senders.bytes_per_s: a flood, or a busy router",
    "route_table_full": "more senders than there is room for: is something flooding the link?",
}


class Refusals:
    """Looks at several counts by reason."""

    def __init__(self, sources: Sequence[Mapping[str, int]]) -> None:
        self._sources = sources
        self._reported: Counter[str] = Counter()

    def totals(self) -> dict[str, int]:
        """How often each reason occurred since the start, those of a healthy day left out."""
        return dict(self._sum())

    def pending_warning(self) -> str | None:
        """What has been refused since the last call, in one line with the mend where there is one; None where nothing was."""
        now = self._sum()
        grown = now - self._reported
        self._reported = now
        for reason in _NOT_WARNED_OF:
            del grown[reason]
        if not grown:
            return None
        items = ", ".join(f"{reason} {times}" for reason, times in grown.most_common(6))
        remedies = "; ".join(_REMEDIES[reason] for reason in grown if reason in _REMEDIES)
        return f"refused on the links: {items}" + (f" ({remedies})" if remedies else "")

    def _sum(self) -> Counter[str]:
        total: Counter[str] = Counter()
        for source in self._sources:
            total.update({reason: times for reason, times in source.items() if reason not in _QUIET})
        return total
