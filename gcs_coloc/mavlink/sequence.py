"""Frames lost on the way, and frames that came twice, by their sequence numbers."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from gcs_coloc.core.snapshot import LinkSnapshot

MAX_SENDERS = 1024
"""Chosen: more than a fleet has components; the one silent for longest makes room."""
COPY_WITHIN_S = 0.5
"""Chosen: a network's copy of a frame comes sooner. Later, equal number and checksum are a sender that repeats itself: one
that never increments its number sends the same heartbeat every second."""
REMEMBERED_FRAMES = 128
"""Half of the 256 sequence numbers: an older one could be a new frame."""


Sender = tuple[Hashable, int, int]
"""Source address, system id, component id: each numbers its frames on its own."""


@dataclass(slots=True)
class Reception:
    """Frames of one sender: `received` without duplicates, `lost` by the gaps in their numbers, `duplicates`.

    A gap is known modulo 256 only, so a silence of more than 127 frames counts too few.
    """

    received: int = 0
    lost: int = 0
    duplicates: int = 0
    _last: int | None = None
    _recent: dict[int, float] = field(default_factory=dict, repr=False)

    def add(self, sequence: int, checksum: int, received_at_s: float) -> bool:
        """Count one frame; False where it is a copy: number and checksum of another not older than `COPY_WITHIN_S`."""
        recent = self._recent
        fingerprint = sequence << 16 | checksum
        seen_at_s = recent.pop(fingerprint, None)
        recent[fingerprint] = received_at_s
        if seen_at_s is not None and received_at_s - seen_at_s <= COPY_WITHIN_S:
            self.duplicates += 1
            return False
        if len(recent) > REMEMBERED_FRAMES:
            del recent[next(iter(recent))]
        self.received += 1
        if self._last is None:
            self._last = sequence
            return True
        step = (sequence - self._last) & 0xFF
        if 0 < step < 128:
            self.lost += step - 1
            self._last = sequence
        elif self.lost:
            self.lost -= 1  # a late one, counted as lost when it was overtaken
        return True


class SequenceTracker:
    """The reception of every sender, at most `MAX_SENDERS`; the one silent for longest makes room for a new one."""

    def __init__(self) -> None:
        self._by_sender: OrderedDict[Sender, Reception] = OrderedDict()

    def add(self, sender: Sender, sequence: int, checksum: int, received_at_s: float) -> bool:
        """Count one frame of `sender`; False where it is a duplicate and must not be used again."""
        by_sender = self._by_sender
        reception = by_sender.get(sender)
        if reception is None:
            if len(by_sender) >= MAX_SENDERS:
                by_sender.popitem(last=False)
            reception = by_sender[sender] = Reception()
        else:
            by_sender.move_to_end(sender)
        return reception.add(sequence, checksum, received_at_s)

    def links(self, sysids: Collection[int]) -> tuple[LinkSnapshot, ...]:
        """The reception of some vehicles, each over all its links and components, in order of their system ids."""
        totals = {sysid: [0, 0, 0] for sysid in sorted(sysids)}
        for (_, sysid, _), reception in self._by_sender.items():
            if sysid in totals:
                for i, count in enumerate((reception.received, reception.lost, reception.duplicates)):
                    totals[sysid][i] += count
        return tuple(LinkSnapshot(sysid, *counts) for sysid, counts in totals.items())

    @property
    def receptions(self) -> Mapping[Sender, Reception]:
        """A live view: reception by sender."""
        return MappingProxyType(self._by_sender)
