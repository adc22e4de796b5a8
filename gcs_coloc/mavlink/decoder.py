"""Datagrams to the core's messages: framing, signature, copies, conversion; all refusals are counted."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Hashable
from dataclasses import dataclass, field
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20.ardupilotmega import (
    MAV_COMP_ID_AUTOPILOT1,
    MAVLINK_MSG_ID_COMMAND_ACK,
    MAVLINK_MSG_ID_DEBUG_VECT,
    MAVLINK_MSG_ID_GPS_INPUT,
    MAVLINK_MSG_ID_HEARTBEAT,
)

from gcs_coloc.core.messages.inbound import Heartbeat, Inbound, PeerRange
from gcs_coloc.core.snapshot import LinkSnapshot
from gcs_coloc.mavlink import checks, framing
from gcs_coloc.mavlink._generated.gcs_coloc import MAVLINK_MSG_ID_RANGING_BEACON
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.framing import MESSAGE_CLASSES, OWN_COMPID, OWN_SYSID, RawFrame, target_of
from gcs_coloc.mavlink.inbound import AUTOPILOT_CONVERTERS, CONVERTERS
from gcs_coloc.mavlink.refusals import Counts, Field, InvalidValue, Refusal
from gcs_coloc.mavlink.signing import LinkSigning

MAX_BEHIND = 64
"""Sources that are sent the time of signatures at once. Chosen: more than a fleet on its links."""

INVALID_SYSID = InvalidValue("header", Field.SYSID)
"""System id 0 addresses everybody and is no sender's."""

_LAYOUTS = {
    number: (MESSAGE_CLASSES[number].unpacker, MESSAGE_CLASSES[number].msgname, convert) for number, convert in CONVERTERS.items()
}


class Frame(NamedTuple):
    """A frame of a message that we decode: its sender, and the core's message in it.

    `message` is None where the frame holds nothing for the core, or was refused.
    """

    sysid: int
    compid: int
    sequence: int
    message_id: int
    message: Inbound | None

    @property
    def is_other_heartbeat(self) -> bool:
        """Whether its sender says that it is no autopilot: a ground station, a companion computer, a camera."""
        return self.message_id == MAVLINK_MSG_ID_HEARTBEAT and self.message is None

    @property
    def is_autopilot_heartbeat(self) -> bool:
        """Whether this frame shows that its sender (`sysid`, `compid`) is an autopilot."""
        return isinstance(self.message, Heartbeat)


class Decoder:
    """Decodes datagrams and counts the frames that it refuses.

    No content makes it raise. `counts` has the refused frames by reason (see `Refusal`).
    A component is an autopilot if its id is 1, or once it has sent an autopilot's heartbeat, as long as no component 1 of its
    system has: a companion computer's script may announce an autopilot of any kind.
    `has_other_service`: the other service of a hot standby uses our system id, with another component id.
    """

    def __init__(self, *, own_sysid: int = OWN_SYSID, own_compid: int = OWN_COMPID, has_other_service: bool = False) -> None:
        self.counts = Counts()
        self.sequences = SequenceTracker()
        self._own = (own_sysid, own_compid)
        self._own_sysid_refusal = Refusal.OTHER_SERVICE if has_other_service else Refusal.OWN_SYSID_USED
        # No bound but that of the ids, of 8 bits each: in a table that is full, forged senders would keep an autopilot out.
        self._autopilots: set[tuple[int, int]] = set()
        self._behind: dict[Hashable, None] = {}
        self._with_companion_ranges: set[int] = set()

    def pop_behind(self) -> tuple[Hashable, ...]:
        """Return the sources of frames refused as SIGNATURE_OLD since the last call, `MAX_BEHIND` at most.

        By MAVLink's rules a key holder that is behind adopts a later time of signatures as soon as it hears one.
        """
        behind = tuple(self._behind)
        self._behind.clear()
        return behind

    def decode(
        self,
        datagram: bytes,
        received_at_s: float,
        source: Hashable = None,
        signing: LinkSigning | None = None,
        good: list[framing.RawFrame] | None = None,
    ) -> list[Frame]:
        """Decode the frames of one datagram, in order.

        `source` is the address it came from: each numbers its frames itself. `signing` is how its link is signed; without,
        signatures are ignored. Every valid frame of others that is no copy is appended to `good`, decoded or not.
        """
        frames: list[Frame] = []
        for raw in framing.split(datagram, self.counts, ended=True)[0]:
            sysid, compid = sender = (raw.sysid, raw.compid)
            if sender == self._own:
                self.counts.add(Refusal.ECHO)
            # Another user of our system id is no vehicle; but another sender of GPS_INPUT must not go unnoticed.
            elif sysid == self._own[0] and raw.message_id != MAVLINK_MSG_ID_GPS_INPUT:
                self.counts.add(self._own_sysid_refusal)
            elif sysid == 0:
                self.counts.add(INVALID_SYSID)
            # Before anything is remembered of the sender, and before the message id decides: an attacker chooses both.
            elif signing is not None and (refusal := signing.refusal(raw, received_at_s)) is not None:
                self.counts.add(refusal)
                if refusal == Refusal.SIGNATURE_OLD and len(self._behind) < MAX_BEHIND:
                    self._behind[source] = None
            elif not self.sequences.add((source, sysid, compid), raw.sequence, raw.checksum, received_at_s):
                self.counts.add(Refusal.DUPLICATE)
            else:
                if good is not None:
                    good.append(raw)
                if raw.message_id in _LAYOUTS:
                    self._decode_frame(raw, sender, received_at_s, frames)
                else:
                    self.counts.add(Refusal.NOT_WANTED if raw.is_known else Refusal.UNKNOWN_MESSAGE)
        return frames

    def _decode_frame(self, raw: framing.RawFrame, sender: tuple[int, int], received_at_s: float, frames: list[Frame]) -> None:
        if raw.message_id in AUTOPILOT_CONVERTERS and not self._is_autopilot(sender):
            self.counts.add(Refusal.NOT_FROM_AUTOPILOT)
        else:
            message = self._message(raw, received_at_s)
            if isinstance(message, PeerRange) and self._is_repeated_by_autopilot(raw):
                self.counts.add(Refusal.DUPLICATE)
                message = None
            if isinstance(message, Heartbeat):
                if self._is_beside_autopilot(sender):
                    message = None
                else:
                    self._autopilots.add(sender)
            frames.append(Frame(raw.sysid, raw.compid, raw.sequence, raw.message_id, message))

    def _is_repeated_by_autopilot(self, raw: framing.RawFrame) -> bool:
        """Whether a DEBUG_VECT is PX4's own copy of a companion computer's.

        PX4 puts its own clock's time in it.
        """
        if raw.message_id != MAVLINK_MSG_ID_DEBUG_VECT:
            return False
        if raw.compid != MAV_COMP_ID_AUTOPILOT1:
            self._with_companion_ranges.add(raw.sysid)
        return raw.compid == MAV_COMP_ID_AUTOPILOT1 and raw.sysid in self._with_companion_ranges

    def _is_autopilot(self, sender: tuple[int, int]) -> bool:
        return sender[1] == MAV_COMP_ID_AUTOPILOT1 or (sender in self._autopilots and not self._is_beside_autopilot(sender))

    def _is_beside_autopilot(self, sender: tuple[int, int]) -> bool:
        """Whether a component is another one of a system whose component 1 is an autopilot."""
        sysid, compid = sender
        return compid != MAV_COMP_ID_AUTOPILOT1 and (sysid, MAV_COMP_ID_AUTOPILOT1) in self._autopilots

    def _is_for_us(self, raw: framing.RawFrame) -> bool:
        """Whether a frame is addressed to us or to everybody, as in MAVLink 1, where these fields are absent."""
        return all(target in (0, own) for target, own in zip(target_of(raw), self._own, strict=True))

    def _message(self, raw: framing.RawFrame, received_at_s: float) -> Inbound | None:
        if raw.message_id == MAVLINK_MSG_ID_COMMAND_ACK and not self._is_for_us(raw):
            self.counts.add(Refusal.ANSWER_TO_ANOTHER)
            return None
        if raw.message_id == MAVLINK_MSG_ID_RANGING_BEACON and target_of(raw).sysid not in (0, self._own[0], raw.sysid):
            self.counts.add(Refusal.RANGE_OF_ANOTHER)
            return None
        unpacker, name, convert = _LAYOUTS[raw.message_id]
        # MAVLink 2 cuts off trailing zeros, MAVLink 1 has no extension fields, a newer sender may append fields.
        payload = raw.payload.ljust(unpacker.size, b"\0")
        try:
            return convert(raw.sysid, received_at_s, unpacker.unpack_from(payload))
        except InvalidValueError as refused:
            self.counts.add(InvalidValue(name, refused.field))
            return None


_IN_E7 = {mavlink.MAVLINK_MSG_ID_SIMSTATE: ("lat", "lng"), mavlink.MAVLINK_MSG_ID_SIM_STATE: ("lat_int", "lon_int")}
TRUTH_IDS = frozenset(_IN_E7)
"""The messages that may hold it."""


class HeardTruth(NamedTuple):
    """The true position of a vehicle in degrees, received at service time `at_s` (s)."""

    sysid: int
    at_s: float
    lat_deg: float
    lon_deg: float


def truth_of(raw: RawFrame, at_s: float) -> HeardTruth | None:
    """Return the true position in a frame of SIMSTATE (164) or SIM_STATE (108) of an autopilot.

    None for any other frame, or where the position is impossible.
    """
    names = _IN_E7.get(raw.message_id)
    if names is None or raw.compid != mavlink.MAV_COMP_ID_AUTOPILOT1:
        return None
    message = MESSAGE_CLASSES[raw.message_id]
    values = message.unpacker.unpack_from(raw.payload.ljust(message.unpacker.size, b"\0"))
    lat_e7, lon_e7 = (values[message.ordered_fieldnames.index(name)] for name in names)
    try:
        # 0, 0 is also what a SIM_STATE without its later fields has here.
        return HeardTruth(raw.sysid, at_s, *checks.latitude_longitude_deg(lat_e7, lon_e7))
    except InvalidValueError:
        return None


MAX_SENDERS = 1024
"""Chosen: more than a fleet has components; the one silent for longest makes room."""
COPY_WITHIN_S = 0.5
"""Chosen: a network's copy of a frame comes sooner. Later, equal number and checksum are a sender that repeats itself: one
that never increments its number sends the same heartbeat every second."""
REMEMBERED_FRAMES = 128
"""Half of the 256 sequence numbers: an older one could be a new frame."""
_WINDOW = (1 << REMEMBERED_FRAMES + 1) - 1


Sender = tuple[Hashable, int, int]
"""Source address, system id, component id: each numbers its frames on its own."""


@dataclass(slots=True)
class Reception:
    """The frames of one sender, counted: received, lost and duplicates.

    `received` is without duplicates; `lost` is by the gaps in the sequence numbers.
    A gap is known modulo 256 only, so a silence of more than 127 frames counts too few.
    A sender that counts anew is followed from its second frame on.
    """

    received: int = 0
    lost: int = 0
    duplicates: int = 0
    _last: int | None = None
    _missing: int = 0  # bit k: the number k before the last one was counted as lost
    _stray: int | None = None  # the number of a frame that was neither the next nor a missing one
    _recent: dict[int, float] = field(default_factory=dict, repr=False)

    def add(self, sequence: int, checksum: int, received_at_s: float) -> bool:
        """Count one frame; return False where it is a copy.

        A copy has the number and checksum of a frame that came at most `COPY_WITHIN_S` before.
        """
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
        behind = 256 - step
        if 0 < step < 128:
            self._last, self._stray = sequence, None
            if step > 1 or self._missing:
                self.lost += step - 1
                self._missing = (self._missing << step | (1 << step) - 2) & _WINDOW
        elif self._missing >> behind & 1:
            self.lost -= 1  # a late one, counted as lost when it was overtaken
            self._missing ^= 1 << behind
        elif self._stray is not None and sequence == (self._stray + 1) & 0xFF:
            self._last, self._stray, self._missing = sequence, None, 0
        else:
            self._stray = sequence
        return True


class SequenceTracker:
    """The reception of every sender, at most `MAX_SENDERS`.

    The sender that was silent for longest makes room for a new one.
    """

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
        """Return the reception of some vehicles, in order of their system ids.

        That of each is the sum over all its links and components.
        """
        totals = {sysid: [0, 0, 0] for sysid in sorted(sysids)}
        for (_, sysid, _), reception in self._by_sender.items():
            if sysid in totals:
                for i, count in enumerate((reception.received, reception.lost, reception.duplicates)):
                    totals[sysid][i] += count
        return tuple(LinkSnapshot(sysid, *counts) for sysid, counts in totals.items())
