"""What the sequence numbers tell: frames lost on the way, and frames that came twice."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

MAX_SENDERS = 1024
REMEMBERED_FRAMES = 128
"""Half a turn of the 8-bit sequence number: within it, equal number and equal checksum mean the same frame."""

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
    _recent: dict[int, None] = field(default_factory=dict, repr=False)

    def note(self, sequence: int, checksum: int) -> bool:
        """Count one frame; False where it is a copy of one of the last `REMEMBERED_FRAMES`."""
        fingerprint = sequence << 16 | checksum
        if fingerprint in self._recent:
            self.duplicates += 1
            return False
        if len(self._recent) >= REMEMBERED_FRAMES:
            del self._recent[next(iter(self._recent))]
        self._recent[fingerprint] = None
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

    def note(self, sender: Sender, sequence: int, checksum: int) -> bool:
        """Count one frame of `sender`; False where it is a duplicate and must not be used again."""
        by_sender = self._by_sender
        reception = by_sender.get(sender)
        if reception is None:
            if len(by_sender) >= MAX_SENDERS:
                by_sender.popitem(last=False)
            reception = by_sender[sender] = Reception()
        else:
            by_sender.move_to_end(sender)
        return reception.note(sequence, checksum)

    @property
    def receptions(self) -> Mapping[Sender, Reception]:
        """A live view: reception by sender."""
        return MappingProxyType(self._by_sender)
