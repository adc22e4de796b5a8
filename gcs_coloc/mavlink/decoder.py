"""Bytes to the core's messages."""

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
from gcs_coloc.mavlink.inbound import AUTOPILOT_CONVERTERS, CONVERTERS
from gcs_coloc.mavlink.refusals import Counts, Field, InvalidValue, Refusal
from gcs_coloc.mavlink.sequence import SequenceTracker
from gcs_coloc.mavlink.signing import LinkSigning
from gcs_coloc.mavlink.targets import target_of

MAX_AUTOPILOTS = 1024
MAX_BEHIND = 64
"""So many sources are told the time of signatures at once."""

INVALID_SYSID = InvalidValue("header", Field.SYSID)
"""System id 0 addresses everybody and is no sender's."""

_LAYOUTS = {
    number: (MESSAGE_CLASSES[number].unpacker, MESSAGE_CLASSES[number].msgname, convert) for number, convert in CONVERTERS.items()
}


class Frame(NamedTuple):
    """A frame of a message that we decode: whose it is, and what it holds for the core (None: nothing, or it was refused)."""

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
    """Decodes datagrams. Nothing that bytes can hold makes it raise: what is of no use is in `counts`, by reason.

    A component is an autopilot if its id is 1, or once it has sent an autopilot's heartbeat, as long as no component 1 of its
    system has: a companion computer's script may announce one of any kind.

    Reasons: those of `framing`; unknown_message (in no dialect of ours); not_wanted (known, but of no use to the core);
    not_from_autopilot (a message that only an autopilot can send about its vehicle, from another component);
    answer_to_another (COMMAND_ACK addressed to another ground station); duplicate; echo (our own frame come back);
    own_sysid (our system id from another component); invalid_value:MESSAGE.field; those of `signing` where a link is signed.
    """

    def __init__(self, *, own_sysid: int = OWN_SYSID, own_compid: int = OWN_COMPID) -> None:
        self.counts = Counts()
        self.sequences = SequenceTracker()
        self._own = (own_sysid, own_compid)
        self._autopilots: set[tuple[int, int]] = set()
        self._behind: dict[Hashable, None] = {}

    def pop_behind(self) -> tuple[Hashable, ...]:
        """The sources, 64 at most, of which a frame was refused as signature_old since the last call.

        By MAVLink's rules a key holder that is behind follows the time of signatures as soon as it hears a later one.
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

        `source` is the address it came from: each numbers its frames itself. `signing` is how the link that it came over is
        signed; without, signatures are passed over. `good` takes every frame that is somebody else's, whole and no copy,
        those of no use to the core too.
        """
        frames: list[Frame] = []
        for raw in framing.split(datagram, self.counts, ended=True)[0]:
            sysid, compid = sender = (raw.sysid, raw.compid)
            if sender == self._own:
                self.counts.add(Refusal.ECHO)
            # Who else uses our system id is no vehicle; but another sender of aid must not go unnoticed by that.
            elif sysid == self._own[0] and raw.message_id != MAVLINK_MSG_ID_GPS_INPUT:
                self.counts.add(Refusal.OWN_SYSID_USED)
            elif sysid == 0:
                self.counts.add(INVALID_SYSID)
            # Before anything is remembered of the sender, and before its message's id decides: both are his to choose.
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
                    self._take(raw, sender, received_at_s, frames)
                else:
                    self.counts.add(Refusal.NOT_WANTED if raw.is_known else Refusal.UNKNOWN_MESSAGE)
        return frames

    def _take(self, raw: framing.RawFrame, sender: tuple[int, int], received_at_s: float, frames: list[Frame]) -> None:
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
        """Whether a frame is addressed to us or, as in MAVLink 1 where these fields are absent, to nobody in particular."""
        return all(target in (0, own) for target, own in zip(target_of(raw), self._own, strict=True))

    def _message(self, raw: framing.RawFrame, received_at_s: float) -> Inbound | None:
        if raw.message_id == MAVLINK_MSG_ID_COMMAND_ACK and not self._is_for_us(raw):
            self.counts.add(Refusal.ANSWER_TO_ANOTHER)
            return None
        unpacker, name, convert = _LAYOUTS[raw.message_id]
        # MAVLink 2 cuts off trailing zeros, MAVLink 1 knows no extension fields, a newer sender may add fields of its own.
        payload = raw.payload.ljust(unpacker.size, b"\0")
        try:
            return convert(raw.sysid, received_at_s, unpacker.unpack_from(payload))
        except InvalidValueError as refused:
            self.counts.add(InvalidValue(name, refused.field))
            return None
