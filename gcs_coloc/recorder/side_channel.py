"""What the engine was told besides the vehicles' frames, kept in the tlog so that a replay tells it the same.

The operator's words, what is known of the routes, the host's UTC, whom somebody else's GPS_INPUT reaches and ranges from
gateways reach the engine by no frame, and neither that the service was held up nor what it was set to shows in one. Each is
written as a TUNNEL frame (385) of our own, with a private payload type and JSON inside; other programs pass over it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.advance import Overrun
from gcs_coloc.core.messages.aiding import ForeignGpsInput
from gcs_coloc.core.messages.control import (
    AidingOverride,
    ClockReference,
    GpsOverride,
    OperatorCommand,
    PrimaryOverride,
    RouteBlock,
    RouteReport,
)
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.mavlink.framing import MAGIC_V2, read_frame

_WORDS: dict[str, type[GpsOverride] | type[AidingOverride] | type[PrimaryOverride]] = {
    "word": GpsOverride,
    "aid": AidingOverride,
    "primary": PrimaryOverride,
}

PAYLOAD_TYPE = 46_232
"""The TUNNEL payload type of a note; above 32767 they are private."""

_MOST_BYTES = 128
_MOST_SHARING = 16
"""System ids of vehicles at one address that fit into a record with all else."""
_TIME_BASES = tuple(TimeBase)


@dataclass(frozen=True, slots=True)
class GroundTool:
    """From now on frames of this system and component are a ground tool's on their way to a vehicle: not the engine's."""

    sysid: int
    compid: int
    received_at_s: float


@dataclass(frozen=True, slots=True)
class FlownWith:
    """What the engine was set to in the flight, as `Settings.fingerprint`."""

    fingerprint: str
    received_at_s: float


SideChannelRecord = (
    FlownWith | ClockReference | OperatorCommand | RouteReport | PeerRange | Overrun | GroundTool | ForeignGpsInput
)


@dataclass(frozen=True, slots=True)
class ReadRecord:
    """A note as read; None marks the beginning of a part. `repeated`: it stands at the head of a part and tells no news."""

    note: SideChannelRecord | None
    repeated: bool


class NoteWriter:
    """Packs notes as frames of ours, numbered on their own."""

    def __init__(self, sysid: int, compid: int) -> None:
        self._mavlink = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)

    def pack(self, note: SideChannelRecord | None, *, repeated: bool = False) -> bytes:
        """A note as a TUNNEL frame; None for the beginning of a part. Of vehicles at one address 16 are named.

        Raises ValueError for numbers with more digits than there is room for.
        """
        content = _content(note) if note is not None else {"begin": 1}
        if repeated:
            content["again"] = 1
        data = json.dumps(content, separators=(",", ":")).encode()
        if len(data) > _MOST_BYTES:
            raise ValueError(f"a note of {len(data)} bytes does not fit into a TUNNEL frame")
        message = mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, len(data), list(data.ljust(_MOST_BYTES, b"\0")))
        frame = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) & 0xFF
        return frame


def read_note(frame: bytes, at_s: float, own: tuple[int, int]) -> ReadRecord | None:
    """The note that a recorded frame holds, or None where it holds none.

    `own` is the system and component id that recorded: nobody else's notes are obeyed.
    """
    if frame[0] != MAGIC_V2 or int.from_bytes(frame[7:10], "little") != mavlink.MAVLINK_MSG_ID_TUNNEL:
        return None
    raw = read_frame(frame, 0)
    if isinstance(raw, str) or (raw.sysid, raw.compid) != own:
        return None
    message = mavlink.MAVLink_tunnel_message
    payload = raw.payload.ljust(message.unpacker.size, b"\0")
    fields = message.unpacker.unpack_from(payload)
    payload_type, length, data = fields[0], fields[3], bytes(fields[4 : 4 + _MOST_BYTES])
    if payload_type != PAYLOAD_TYPE:
        return None
    try:
        content = json.loads(data[:length])
        return ReadRecord(_note(content, at_s), "again" in content)
    except (ValueError, KeyError, TypeError):
        return None


def _content(note: SideChannelRecord) -> dict[str, Any]:
    if isinstance(note, ClockReference):
        return {"utc": note.utc_minus_service_s, "sync": note.synchronised}
    if isinstance(note, FlownWith):
        return {"settings": note.fingerprint}
    if isinstance(note, GroundTool):
        return {"ground": [note.sysid, note.compid]}
    if isinstance(note, PeerRange):
        base = _TIME_BASES.index(note.time_base)
        ends, told = (note.sysid, note.peer_sysid), (note.range_m, note.sigma_m, note.measured_at_s, base)
        return {"range": [*ends, *told, note.sequence, note.line_of_sight, note.device_id]}
    if isinstance(note, Overrun):
        return {"held": note.since_s}
    if isinstance(note, ForeignGpsInput):
        return {"other": [note.sysid, note.gps_id, note.vehicle]}
    if isinstance(note, OperatorCommand):
        return {
            next(key for key, kind in _WORDS.items() if isinstance(note.override, kind)): note.override.value,
            "of": note.sysid,
        }
    return {"route": note.blocked, "of": note.sysid} | ({"with": note.shared_with[:_MOST_SHARING]} if note.shared_with else {})


def _note(content: dict[str, Any], at_s: float) -> SideChannelRecord | None:
    if "begin" in content:
        return None
    if "utc" in content:
        utc = content["utc"]
        sync = content.get("sync")
        return ClockReference(at_s, float(utc) if utc is not None else None, bool(sync) if sync is not None else None)
    if "held" in content:
        return Overrun(at_s, float(content["held"]))
    if "settings" in content:
        return FlownWith(str(content["settings"]), at_s)
    if "ground" in content:
        sysid, compid = content["ground"]
        return GroundTool(int(sysid), int(compid), at_s)
    if "range" in content:
        sysid, peer, range_m, sigma_m, measured_at_s, base, sequence, line_of_sight, device_id = content["range"]
        time_base = _TIME_BASES[base]
        return PeerRange(sysid, at_s, peer, range_m, sigma_m, measured_at_s, time_base, sequence, line_of_sight, device_id)
    if "other" in content:
        sender, gps_id, vehicle = content["other"]
        return ForeignGpsInput(sender, at_s, gps_id, vehicle)
    sysid = int(content["of"])
    for key, kind in _WORDS.items():
        if key in content:
            return OperatorCommand(sysid, at_s, kind(content[key]))
    return RouteReport(sysid, at_s, _route_block(content["route"]), tuple(map(int, content.get("with", ()))))


def _route_block(content: str | None) -> RouteBlock | None:
    """Why nothing could be sent to a vehicle. Until 0.1 a recording held the beginning of a sentence."""
    if content is None or content in RouteBlock.__members__.values():
        return RouteBlock(content) if content is not None else None
    return RouteBlock.SHARED_ADDRESS if "one address" in content else RouteBlock.NO_HEARTBEAT
