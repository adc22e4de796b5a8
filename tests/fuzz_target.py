"""What the fuzzers run: an attacker's bytes through framing, signing and decoding, with what must hold whatever they are."""

from __future__ import annotations

import hashlib

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.framing import MESSAGE_CLASSES, StreamFramer
from gcs_coloc.mavlink.inbound import CONVERTERS
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.mavlink.signing import LinkSigning, Signing

KEY = hashlib.sha256(b"not known to the attacker").digest()
UNIX_S = 1_800_000_000.0
WANTED = sorted(CONVERTERS)


def run(data: bytes) -> None:
    """The first byte says what is made of the others: raw bytes, or the payload and the stamp of a frame with a right checksum.

    Raises AssertionError where something does not hold; whatever else comes out is a crash.
    """
    if not data:
        return
    kind, rest = data[0], bytes(data[1:])
    if kind < 128:
        _attack(rest)
    else:
        _of_a_key_holder(kind, rest)


def _attack(datagram: bytes) -> None:
    """Nothing of an attacker without the key is taken or remembered where signatures are required; elsewhere nothing raises."""
    signing, decoder = _signing(), Decoder()
    assert decoder.decode(datagram, 0.0, "source", LinkSigning(signing, 0, required=True)) == []
    assert signing.streams == 0
    assert not any(link.received for link in decoder.sequences.links(set(datagram)))
    assert signing.stamp(0, 0.0) == _signing().stamp(0, 0.0)
    assert not datagram or decoder.counts
    for link in (LinkSigning(signing, 0, required=False), None):
        assert len(Decoder().decode(datagram, 0.0, "source", link)) <= len(datagram) // 8
    assert signing.streams == 0
    whole, halves = StreamFramer(Counts()), StreamFramer(Counts())
    middle = len(datagram) // 2
    assert whole.feed(datagram) == halves.feed(datagram[:middle]) + halves.feed(datagram[middle:])


def _of_a_key_holder(kind: int, rest: bytes) -> None:
    """Any payload and any stamp of one who has the key: taken once at most, and never again."""
    message_class = MESSAGE_CLASSES[WANTED[kind % len(WANTED)]]
    sender = mavlink.MAVLink(None, srcSystem=1 + kind % 250, srcComponent=1)
    sender.signing.secret_key, sender.signing.sign_outgoing, sender.signing.link_id = KEY, True, kind
    sender.signing.timestamp = int.from_bytes(rest[:6], "little")
    payload = rest[6 : 6 + message_class.unpacker.size].ljust(message_class.unpacker.size, b"\0")
    blank = mavlink.MAVLink_message(message_class.id, message_class.msgname)
    frame = bytes(blank._pack(sender, message_class.crc_extra, payload))
    signing, decoder = _signing(), Decoder()
    link = LinkSigning(signing, 0, required=True)
    first = decoder.decode(frame, 0.0, "source", link)
    assert len(first) == signing.streams <= 1
    assert decoder.decode(frame, 1.0, "source", link) == []
    assert signing.stamp(0, 1.0).timestamp < 2**48


def _signing() -> Signing:
    signing = Signing(KEY)
    signing.set_clock(UNIX_S)
    return signing
