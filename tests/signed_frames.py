"""Frames signed by pymavlink, an independent implementation of both ends of a signed link."""

from __future__ import annotations

import hashlib

from pymavlink.dialects.v20 import ardupilotmega as mavlink

KEY = bytes(range(32))
OTHER_KEY = bytes(range(1, 33))
UNIX_S = 1_800_000_000.0
TICKS = round((UNIX_S - 1_420_070_400.0) * 1e5)
"""`UNIX_S` as the time of a signature."""


class Signer:
    """A vehicle that signs: `sysid`, `compid`, number of its link, time of its next signature in 10 us since 2015."""

    def __init__(self, sysid=1, *, compid=1, key=KEY, link_id=0, ticks=TICKS):
        self.mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self.mav.signing.secret_key = key
        self.mav.signing.sign_outgoing = key is not None
        self.mav.signing.link_id = link_id
        self.mav.signing.timestamp = ticks

    def pack(self, message=None, *, ticks=None) -> bytes:
        if ticks is not None:
            self.mav.signing.timestamp = ticks
        data = bytes((message or heartbeat()).pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        return data


def heartbeat():
    return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)


def of_unknown_id(frame: bytes, key: bytes | None = KEY) -> bytes:
    """The same frame with a message id that is in no dialect; signed anew where a key is given, else unsigned."""
    body = bytearray(frame[:-13]) if frame[2] & 1 else bytearray(frame)
    body[7:10] = (0xABCDEF).to_bytes(3, "little")
    body[2] = 1 if key else 0
    if key is None:
        return bytes(body)
    body += frame[-13:-6] if frame[2] & 1 else bytes([0]) + TICKS.to_bytes(6, "little")
    return bytes(body) + hashlib.sha256(key + body).digest()[:6]
