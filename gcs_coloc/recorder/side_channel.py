"""Side-channel records: what the engine received besides the vehicles' frames.

They are written to the tlog, so that a replay repeats what the engine received.

Operator overrides, routes, the host's UTC, foreign GPS_INPUT, ranges from gateways, overruns, settings, and whether a hot
standby holds it back are in no frame.
Each record is a TUNNEL frame (385) of our own, with a private payload type and JSON inside; other programs ignore it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.deadlines import Overrun
from gcs_coloc.core.messages.control import (
    OVERRIDE_KINDS,
    ClockReference,
    CommandSource,
    ForeignGpsInput,
    HoldBack,
    OperatorCommand,
    RouteBlock,
    RouteReport,
    SwitchedByOther,
    SwitchedReceiver,
)
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.mavlink.framing import MAGIC_V2, read_frame

_KEYS_OF_0_1 = {
    "word": "gps",
    "aid": "aiding",
    "primary": "gps_primary",
    "of": "sysid",
    "held": "overrun",
    "other": "foreign_gps_input",
    "ground": "ground_tool",
    "begin": "segment",
    "again": "repeated",
}
"""The keys that version 0.1 wrote, and today's."""

PAYLOAD_TYPE = 46_232
"""The TUNNEL payload type of a record. Private types are those above 32767 (MAV_TUNNEL_PAYLOAD_TYPE)."""

_MAX_BYTES = 128
"""The payload field of TUNNEL."""
_MAX_SHARING = 16
"""System ids of vehicles at one address; so many fit into a record."""
_TIME_BASES = tuple(TimeBase)


@dataclass(frozen=True, slots=True)
class GroundTool:
    """A mark that frames of this system and component come from a ground tool from now on.

    The engine does not receive them.
    """

    sysid: int
    compid: int
    received_at_s: float


@dataclass(frozen=True, slots=True)
class FlownWith:
    """The settings of the engine in the flight, as `Settings.fingerprint`."""

    fingerprint: str
    received_at_s: float


SideChannelRecord = (
    FlownWith
    | ClockReference
    | OperatorCommand
    | RouteReport
    | PeerRange
    | Overrun
    | GroundTool
    | ForeignGpsInput
    | HoldBack
    | SwitchedByOther
)


@dataclass(frozen=True, slots=True)
class ReadRecord:
    """A record as read from a tlog.

    `record` is None for the mark at the beginning of a segment. `repeated`: it was copied from an earlier segment.
    """

    record: SideChannelRecord | None
    repeated: bool


class SideChannelWriter:
    """Packs records as frames of ours, with their own sequence numbers."""

    def __init__(self, sysid: int, compid: int) -> None:
        self._mavlink = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)

    def pack(self, record: SideChannelRecord | None, *, repeated: bool = False) -> bytes:
        """A record as a TUNNEL frame, or the mark at the beginning of a segment for None.

        Of vehicles at one address the first 16 are named.

        Raises:
            ValueError: its numbers have more digits than fit into the frame.
        """
        content = _content(record) if record is not None else {"segment": 1}
        if repeated:
            content["repeated"] = 1
        data = json.dumps(content, separators=(",", ":")).encode()
        if len(data) > _MAX_BYTES:
            raise ValueError(f"a record of {len(data)} bytes does not fit into a TUNNEL frame")
        message = mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, len(data), list(data.ljust(_MAX_BYTES, b"\0")))
        frame = bytes(message.pack(self._mavlink))
        self._mavlink.seq = (self._mavlink.seq + 1) & 0xFF
        return frame


def read_side_channel(frame: bytes, at_s: float, own: tuple[int, int]) -> ReadRecord | None:
    """The record in a frame of a tlog; None where the frame is no record.

    `own` is the system and component id that recorded; records of others are ignored.
    """
    if frame[0] != MAGIC_V2 or int.from_bytes(frame[7:10], "little") != mavlink.MAVLINK_MSG_ID_TUNNEL:
        return None
    raw = read_frame(frame, 0)
    if isinstance(raw, str) or (raw.sysid, raw.compid) != own:
        return None
    message = mavlink.MAVLink_tunnel_message
    payload = raw.payload.ljust(message.unpacker.size, b"\0")
    fields = message.unpacker.unpack_from(payload)
    payload_type, length, data = fields[0], fields[3], bytes(fields[4 : 4 + _MAX_BYTES])
    if payload_type != PAYLOAD_TYPE:
        return None
    try:
        content = {_KEYS_OF_0_1.get(key, key): value for key, value in json.loads(data[:length]).items()}
        return ReadRecord(_record(content, at_s), "repeated" in content)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _content(record: SideChannelRecord) -> dict[str, Any]:
    if isinstance(record, ClockReference):
        lag = {"lag": round(record.lag_s, 3)} if record.lag_s else {}
        return {"utc": record.utc_minus_service_s, "sync": record.synchronised} | lag
    if isinstance(record, FlownWith):
        return {"settings": record.fingerprint}
    if isinstance(record, GroundTool):
        return {"ground_tool": [record.sysid, record.compid]}
    if isinstance(record, PeerRange):
        base = _TIME_BASES.index(record.time_base)
        ends, values = (record.sysid, record.peer), (record.range_m, record.sigma_m, record.measured_at_s, base)
        return {"range": [*ends, *values, record.sequence, record.line_of_sight, record.device_id]}
    if isinstance(record, Overrun):
        return {"overrun_until": record.until_s}
    if isinstance(record, ForeignGpsInput):
        return {"foreign_gps_input": [record.sysid, record.gps_id, record.vehicle]}
    if isinstance(record, HoldBack):
        return {"held_back": record.held}
    if isinstance(record, SwitchedByOther):
        return {"switched": [*record.receiver, record.held]}
    if isinstance(record, OperatorCommand):
        return {
            next(key for key, kind in OVERRIDE_KINDS.items() if isinstance(record.override, kind)): record.override.value,
            "sysid": record.sysid,
            **({"by": record.source} if record.source is not None else {}),
        }
    return {"route": record.blocked, "sysid": record.sysid} | (
        {"with": record.shared_with[:_MAX_SHARING]} if record.shared_with else {}
    )


def _record(content: dict[str, Any], at_s: float) -> SideChannelRecord | None:
    if "segment" in content:
        return None
    if "utc" in content:
        utc = content["utc"]
        sync = content.get("sync")
        return ClockReference(
            at_s,
            float(utc) if utc is not None else None,
            bool(sync) if sync is not None else None,
            float(content.get("lag", 0.0)),
        )
    if "overrun_until" in content:
        return Overrun(at_s, float(content["overrun_until"]))
    if "overrun" in content:  # since when, told at its end: so earlier versions wrote it
        return Overrun(float(content["overrun"]), at_s)
    if "settings" in content:
        return FlownWith(str(content["settings"]), at_s)
    if "ground_tool" in content:
        sysid, compid = content["ground_tool"]
        return GroundTool(int(sysid), int(compid), at_s)
    if "range" in content:
        sysid, peer, range_m, sigma_m, measured_at_s, base, sequence, line_of_sight, device_id = content["range"]
        time_base = _TIME_BASES[base]
        return PeerRange(sysid, at_s, peer, range_m, sigma_m, measured_at_s, time_base, sequence, line_of_sight, device_id)
    if "foreign_gps_input" in content:
        sender, gps_id, vehicle = content["foreign_gps_input"]
        return ForeignGpsInput(sender, at_s, gps_id, vehicle)
    if "held_back" in content:
        return HoldBack(at_s, bool(content["held_back"]))
    if "switched" in content:
        sysid, before, kind, held = content["switched"]
        return SwitchedByOther(at_s, SwitchedReceiver(int(sysid), before, kind), bool(held))
    sysid = int(content["sysid"])
    for key, kind in OVERRIDE_KINDS.items():
        if key in content:
            source = CommandSource(content["by"]) if "by" in content else None
            return OperatorCommand(sysid, at_s, kind(content[key]), source)
    return RouteReport(sysid, at_s, _route_block(content["route"]), tuple(map(int, content.get("with", ()))))


def _route_block(content: str | None) -> RouteBlock | None:
    """Why nothing could be sent to a vehicle. Version 0.1 wrote the beginning of a sentence."""
    if content is None or content in RouteBlock.__members__.values():
        return RouteBlock(content) if content is not None else None
    return RouteBlock.SHARED_ADDRESS if "one address" in content else RouteBlock.NO_HEARTBEAT
