"""Datagrams to the core's messages: framing, signature, copies, conversion; all refusals are counted."""

from __future__ import annotations

from collections.abc import Hashable
from typing import NamedTuple

from pymavlink.dialects.v20.ardupilotmega import (
    MAV_COMP_ID_AUTOPILOT1,
    MAVLINK_MSG_ID_COMMAND_ACK,
    MAVLINK_MSG_ID_GPS_INPUT,
)

from gcs_coloc.core.messages.inbound import Heartbeat, Inbound
from gcs_coloc.mavlink import framing
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.dialect import MESSAGE_CLASSES, OWN_COMPID, OWN_SYSID
from gcs_coloc.mavlink.framing import target_of
from gcs_coloc.mavlink.inbound import AUTOPILOT_CONVERTERS, CONVERTERS
from gcs_coloc.mavlink.refusals import Counts, Field, InvalidValue, Refusal
from gcs_coloc.mavlink.sequence import SequenceTracker
from gcs_coloc.mavlink.signing import LinkSigning

MAX_AUTOPILOTS = 1024
"""Senders that are remembered as autopilots. Chosen: more than a fleet has components."""
MAX_BEHIND = 64
"""Sources that are sent the time of signatures at once. Chosen: more than a fleet on its links."""

INVALID_SYSID = InvalidValue("header", Field.SYSID)
"""System id 0 addresses everybody and is no sender's."""

_LAYOUTS = {
    number: (MESSAGE_CLASSES[number].unpacker, MESSAGE_CLASSES[number].msgname, convert) for number, convert in CONVERTERS.items()
}


class Frame(NamedTuple):
    """A frame of a message that we decode: its sender, and the core's message in it (None: there is none, or it was refused)."""

    sysid: int
    compid: int
    sequence: int
    message_id: int
    message: Inbound | None

    @property
    def is_autopilot_heartbeat(self) -> bool:
        """Whether this frame shows that its sender (`sysid`, `compid`) is an autopilot."""
        return isinstance(self.message, Heartbeat)


class Decoder:
    """Decodes datagrams. No content makes it raise: refused frames are in `counts`, by reason (see `Refusal`).

    A component is an autopilot if its id is 1, or once it has sent an autopilot's heartbeat, as long as no component 1 of its
    system has: a companion computer's script may announce one of any kind.
    """

    def __init__(self, *, own_sysid: int = OWN_SYSID, own_compid: int = OWN_COMPID) -> None:
        self.counts = Counts()
        self.sequences = SequenceTracker()
        self._own = (own_sysid, own_compid)
        self._autopilots: set[tuple[int, int]] = set()
        self._behind: dict[Hashable, None] = {}

    def pop_behind(self) -> tuple[Hashable, ...]:
        """The sources, `MAX_BEHIND` at most, of which a frame was refused as SIGNATURE_OLD since the last call.

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
                self.counts.add(Refusal.OWN_SYSID_USED)
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
            if isinstance(message, Heartbeat):
                if self._is_beside_autopilot(sender):
                    message = None
                elif len(self._autopilots) < MAX_AUTOPILOTS:
                    self._autopilots.add(sender)
            frames.append(Frame(raw.sysid, raw.compid, raw.sequence, raw.message_id, message))

    def _is_autopilot(self, sender: tuple[int, int]) -> bool:
        return sender[1] == MAV_COMP_ID_AUTOPILOT1 or (sender in self._autopilots and not self._is_beside_autopilot(sender))

    def _is_beside_autopilot(self, sender: tuple[int, int]) -> bool:
        """Whether a component has its system's autopilot, component 1, beside it."""
        sysid, compid = sender
        return compid != MAV_COMP_ID_AUTOPILOT1 and (sysid, MAV_COMP_ID_AUTOPILOT1) in self._autopilots

    def _is_for_us(self, raw: framing.RawFrame) -> bool:
        """Whether a frame is addressed to us or to everybody, as in MAVLink 1, where these fields are absent."""
        return all(target in (0, own) for target, own in zip(target_of(raw), self._own, strict=True))

    def _message(self, raw: framing.RawFrame, received_at_s: float) -> Inbound | None:
        if raw.message_id == MAVLINK_MSG_ID_COMMAND_ACK and not self._is_for_us(raw):
            self.counts.add(Refusal.ANSWER_TO_ANOTHER)
            return None
        unpacker, name, convert = _LAYOUTS[raw.message_id]
        # MAVLink 2 cuts off trailing zeros, MAVLink 1 has no extension fields, a newer sender may append fields.
        payload = raw.payload.ljust(unpacker.size, b"\0")
        try:
            return convert(raw.sysid, received_at_s, unpacker.unpack_from(payload))
        except InvalidValueError as refused:
            self.counts.add(InvalidValue(name, refused.field))
            return None
