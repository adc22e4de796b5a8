"""MAVLink 2 signatures, sans-IO: which frames may be used, and the stamps of ours.

Rules: https://mavlink.io/en/guide/message_signing.html. Two more close what the rules leave open to an attacker: a frame
changes nothing here before its signature is verified, and the time of a stream is kept for all links together, so that a
frame of one link cannot be played back on another.
"""

from __future__ import annotations

import hashlib
import hmac
from collections import OrderedDict
from dataclasses import dataclass, field

from pymavlink.dialects.v20.ardupilotmega import MAVLINK_MSG_ID_RADIO_STATUS

from gcs_coloc.mavlink.checks import UNIX_TIME_TO_US
from gcs_coloc.mavlink.framing import SIGNATURE_LENGTH, RawFrame
from gcs_coloc.mavlink.refusals import Refusal

KEY_LENGTH = 32  # bytes. Source: MAVLink guide, message signing; SETUP_SIGNING.secret_key
EPOCH_UNIX_S = 1_420_070_400
"""2015-01-01 UTC, from which signatures count their time."""
TICKS_PER_S = 100_000  # source: MAVLink, message signing, 10 us
FIRST_CONTACT_S = 60  # source: the same, one minute
FIRST_CONTACT_TICKS = FIRST_CONTACT_S * TICKS_PER_S
"""A stream that was never heard may be one minute behind our time (message_signing.html); further behind it is a recording."""
LATEST_TICKS = (UNIX_TIME_TO_US // 1_000_000 - EPOCH_UNIX_S) * TICKS_PER_S
"""The year 2100. Both ends adopt a later time, so a sender far ahead would use up the counter of 48 bits."""
MAX_STREAMS = 1024
"""Chosen: more than a fleet has components and links."""

_DIGEST_LENGTH = 6  # bytes. Source: MAVLink guide, message signing: the first 48 bits of SHA-256
_TIME_LENGTH = 6  # bytes. Source: the same: the timestamp has 48 bits


@dataclass(frozen=True, slots=True)
class Stamp:
    """The inputs of one signature of ours: key, link number and time.

    No other frame of ours has the same time.
    """

    key: bytes = field(repr=False)
    link_id: int
    timestamp: int


class Signing:
    """A secret key, the time of its signatures, and the last stamp of every stream heard.

    Our time is the latest of the host's clock, our last stamp and the latest verified stamp. A stream is a system, a component
    and a link number of the sender's. At most `max_streams` are kept. A stream makes room for a new one only when its last
    stamp is so old that it would be refused at a first contact.
    """

    def __init__(self, key: bytes, *, max_streams: int = MAX_STREAMS) -> None:
        if len(key) != KEY_LENGTH:
            raise ValueError(f"a signing key has {KEY_LENGTH} bytes, not {len(key)}")
        self._key = key
        self._max_streams = max_streams
        self._unix_minus_service_s: float | None = None
        self._latest = 0
        # In the order of last hearing, so the first one is the likeliest to be outdated.
        self._streams: OrderedDict[tuple[int, int, int], int] = OrderedDict()

    @property
    def streams(self) -> int:
        """How many streams are kept."""
        return len(self._streams)

    def set_clock(self, unix_minus_service_s: float | None) -> None:
        """Set how far the host's UNIX time is ahead of the service's clock, s.

        None: the host does not know the time.
        """
        self._unix_minus_service_s = unix_minus_service_s

    def stamp(self, link_id: int, now_s: float) -> Stamp:
        """Return the stamp of our next frame on link `link_id` (0 to 255).

        Its time is later than that of every one before. `now_s` is service time.
        """
        self._latest = max(self._latest + 1, self._now(now_s))
        return Stamp(self._key, link_id, self._latest)

    def ahead_s(self, now_s: float) -> float:
        """Return how far the time of our signatures is ahead of the host's clock, s.

        0 where the host's time is unknown. `now_s` is service time.
        """
        return 0.0 if self._unix_minus_service_s is None else max(self._latest - self._now(now_s), 0) / TICKS_PER_S

    def refusal(self, raw: RawFrame, now_s: float) -> Refusal | None:
        """Return why a signed frame must not be used; None where it may be.

        A frame that may be used sets the time of its stream. `now_s` is the service time at which it came.
        The reasons are those of `Refusal` under signing, and DUPLICATE.
        """
        frame = raw.frame
        signature = hashlib.sha256(self._key + frame[:-_DIGEST_LENGTH]).digest()[:_DIGEST_LENGTH]
        if not hmac.compare_digest(signature, frame[-_DIGEST_LENGTH:]):
            return Refusal.SIGNATURE_WRONG
        timestamp = int.from_bytes(frame[-_DIGEST_LENGTH - _TIME_LENGTH : -_DIGEST_LENGTH], "little")
        if timestamp > LATEST_TICKS:
            return Refusal.SIGNATURE_FUTURE
        stream = (raw.sysid, raw.compid, frame[-SIGNATURE_LENGTH])
        last = self._streams.get(stream)
        if last is not None:
            if timestamp <= last:
                return Refusal.DUPLICATE if timestamp == last else Refusal.SIGNATURE_REPLAYED
        else:
            oldest = max(self._latest, self._now(now_s)) - FIRST_CONTACT_TICKS
            if timestamp < oldest:
                return Refusal.SIGNATURE_OLD
            if not self._has_room(oldest):
                return Refusal.SIGNATURE_STREAMS_FULL
        self._streams[stream] = timestamp
        self._streams.move_to_end(stream)
        self._latest = max(self._latest, timestamp)
        return None

    def _now(self, now_s: float) -> int:
        if self._unix_minus_service_s is None:
            return 0
        return int((now_s + self._unix_minus_service_s - EPOCH_UNIX_S) * TICKS_PER_S)

    def _has_room(self, oldest: int) -> bool:
        if len(self._streams) < self._max_streams:
            return True
        stream, last = next(iter(self._streams.items()))
        if last >= oldest:
            return False
        del self._streams[stream]
        return True


@dataclass(frozen=True, slots=True)
class LinkSigning:
    """How one link is signed.

    `link_id`: its number in our stamps, 0 to 255. `required`: unsigned frames are refused on it.
    """

    signing: Signing
    link_id: int
    required: bool

    def refusal(self, raw: RawFrame, now_s: float) -> Refusal | None:
        """Return why a frame that came over this link must not be used; None where it may be.

        The reasons are those of `Signing.refusal`, or that the frame is unsigned.
        """
        if raw.is_signed:
            return self.signing.refusal(raw, now_s)
        if not self.required:
            return None
        return Refusal.UNSIGNED_RADIO_STATUS if raw.message_id == MAVLINK_MSG_ID_RADIO_STATUS else Refusal.UNSIGNED

    def stamp(self, now_s: float) -> Stamp:
        """The stamp of our next frame on this link at service time `now_s`."""
        return self.signing.stamp(self.link_id, now_s)
