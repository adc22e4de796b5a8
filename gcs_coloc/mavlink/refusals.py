"""Refusals of bytes, frames and messages: their reasons, counts and wording.

The wording is for the operator.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum


class Refusal(StrEnum):
    """A reason that links, decoder and routes count by. Its value is the `reason` label of the metric."""

    # Framing
    GARBAGE_BYTES = "garbage_bytes"
    """Bytes that belong to no frame; counted one by one."""
    NO_MAGIC = "no_magic"
    """A byte that begins no frame; counted as GARBAGE_BYTES only."""
    TRUNCATED = "truncated"
    BAD_CRC = "bad_crc"
    SYSTEM_ID_32_BIT = "system_id_32_bit"
    """A MAVLink 2.1 frame whose header has a system id or a target of 32 bits: not read."""
    UNKNOWN_INCOMPAT_FLAGS = "unknown_incompat_flags"
    UNVERIFIABLE = "unverifiable"
    """A message id of no known dialect, where no other frame follows: its checksum cannot be tested."""
    REST_DROPPED = "rest_dropped"
    """A datagram with more false starts of frames than are looked through."""

    # Decoding
    ECHO = "echo"
    """Our own frame came back."""
    OWN_SYSID_USED = "own_sysid"
    """Another component sends under our system id."""
    OTHER_SERVICE = "other_service"
    """The other service of a hot standby sends under our system id."""
    DUPLICATE = "duplicate"
    """A copy of a frame that was received before."""
    NOT_WANTED = "not_wanted"
    """A known message that the core does not use."""
    UNKNOWN_MESSAGE = "unknown_message"
    NOT_FROM_AUTOPILOT = "not_from_autopilot"
    """A message that only an autopilot can send about its vehicle, from another component."""
    ANSWER_TO_ANOTHER = "answer_to_another"
    """A COMMAND_ACK addressed to another ground station."""
    RANGE_OF_ANOTHER = "range_of_another"
    """A RANGING_BEACON addressed to another system than its sender or us: it is no range that its sender measured."""

    # Signing
    UNSIGNED = "unsigned"
    UNSIGNED_RADIO_STATUS = "unsigned_radio_status"
    """Telemetry radios report on themselves between the frames and have no key."""
    SIGNATURE_WRONG = "signature_wrong"
    """The frame was altered, or signed with another key."""
    SIGNATURE_REPLAYED = "signature_replayed"
    """The frame is older than the last one of its stream."""
    SIGNATURE_OLD = "signature_old"
    """The first frame of its stream is over a minute behind our time."""
    SIGNATURE_FUTURE = "signature_future"
    """The frame is signed for a time after 2100."""
    SIGNATURE_STREAMS_FULL = "signature_streams_full"

    # Links to vehicles
    RATE_LIMITED = "rate_limited"
    ADDRESS_CONFLICT = "address_conflict"
    ROUTE_TABLE_FULL = "route_table_full"
    NOT_SENT = "not_sent"
    NOT_CONNECTED = "not_connected"
    RECEIVE_ERROR = "receive_error"
    OUTPUT_SKIPPED = "output_skipped"
    """The oldest waiting output of a stream that takes less than it is sent."""
    CONNECTION_LOST = "connection_lost"
    TOO_MANY_CLIENTS = "too_many_clients"
    NOT_ENCODABLE = "not_encodable"
    """An output with a number that is not finite or does not fit its field."""

    # Ground tools
    UNKNOWN_GROUND_TOOL = "ground_tool_unknown_sender"
    TOO_MANY_GROUND_TOOLS = "too_many_ground_tools"
    GROUND_TOOL_UNKNOWN_TARGET = "ground_tool_unknown_target"
    GROUND_TOOL_USES_VEHICLE_ID = "ground_tool_uses_vehicle_id"
    GROUND_TOOL_AIDING = "ground_tool_aiding"
    """A ground tool sends positions to a vehicle that we aid."""
    FORWARD_ADDRESS_CONFLICT = "forward_address_conflict"

    # Recordings
    DAMAGED_BYTES = "damaged_bytes"
    """Bytes of a recording that belong to no record; counted one by one."""
    WRONG_TIMES = "wrong_times"
    """Records whose time is not between those of the records before and after."""
    CLOCK_WENT_BACK = "clock_went_back"
    """How often the clock that a recording was written by went back."""
    NOT_RECORDED = "not_recorded"
    """A frame or entry that the disk was too slow to take."""


class Field(StrEnum):
    """A field of a message that held an impossible value, by MAVLink's name of it."""

    AIRSPEED = "airspeed"
    ALT = "alt"
    ALT_TYPE = "alt_type"
    PRESS_ABS = "press_abs"
    FIX_TYPE = "fix_type"
    LAT = "lat"
    LAT_LON_ZERO = "lat_lon_zero"
    """Latitude and longitude are both 0: a receiver without a position."""
    LON = "lon"
    NAME = "name"
    PARAM_ID = "param_id"
    PEER_SYSTEM = "peer_system"
    PEER_SYSTEM_ID = "peer_system_id"
    PEER_TYPE = "peer_type"
    PITCH = "pitch"
    QUALITY = "quality"
    RANGE = "range"
    RANGE_ACCURACY = "range_accuracy"
    RANGE_STD = "range_std"
    ROLL = "roll"
    SYSID = "sysid"
    TC1 = "tc1"
    TIME_UNIX_USEC = "time_unix_usec"
    TIME_USEC = "time_usec"
    VALUE = "value"
    X = "x"
    Y = "y"
    YAW = "yaw"
    Z = "z"


class InvalidValue(str):
    """The reason of a frame with an impossible value, `invalid_value:MESSAGE.field`.

    There are as many reasons as messages and fields.
    """

    __slots__ = ()

    def __new__(cls, message: str, field: Field) -> InvalidValue:
        """`message` is the name of a message that is decoded, or "header"."""
        return super().__new__(cls, f"invalid_value:{message}.{field}")


Reason = StrEnum | InvalidValue
"""A member of a closed set, so that the counts are bounded whatever is sent to us."""


class Counts(Counter[str]):
    """How often each reason occurred since the start."""

    def add(self, reason: Reason, times: int = 1) -> None:
        """Count `reason` as having occurred `times` more times."""
        self[reason] += times


_ROUTINE = frozenset(
    {
        Refusal.NOT_WANTED,
        Refusal.UNKNOWN_MESSAGE,
        Refusal.ECHO,
        Refusal.OTHER_SERVICE,
        Refusal.DUPLICATE,
        Refusal.UNSIGNED_RADIO_STATUS,
    }
)
"""Part of every healthy day: other programs' messages, our own frames come back, radios that deliver twice. Not shown."""
_WITHOUT_WARNING = frozenset({Refusal.ANSWER_TO_ANOTHER})
"""Shown, but nothing to warn of: vehicles answer to every ground station that commands them."""
_REMEDIES: Mapping[str, str] = {
    Refusal.GARBAGE_BYTES: "bytes that are no MAVLink: where nobody is heard on a serial link, a wrong baud rate",
    Refusal.SYSTEM_ID_32_BIT: "MAVLink 2.1 frames with 32-bit ids are not read: give vehicles system ids from 1 to 255",
    Refusal.ADDRESS_CONFLICT: "two senders use one system id: give every vehicle its own (SYSID_THISMAV or MAV_SYSID)",
    Refusal.UNSIGNED: "a link that requires signatures: give the vehicle the key, or is somebody pretending?",
    Refusal.SIGNATURE_WRONG: "the vehicle has another key than ours, or somebody is pretending",
    Refusal.SIGNATURE_REPLAYED: "frames out of order, or somebody plays back what was recorded",
    Refusal.SIGNATURE_OLD: "signed over a minute before our time: a vehicle that follows ours once it hears us, or a recording",
    Refusal.SIGNATURE_FUTURE: "the vehicle's signing time is beyond 2100: its clock is wrong",
    Refusal.SIGNATURE_STREAMS_FULL: "more signed senders than there is room for",
    Refusal.NOT_SENT: "the system does not send there: is there no way to it?",
    Refusal.OUTPUT_SKIPPED: "somebody on a serial or TCP link takes less than it is sent; the oldest was dropped",
    Refusal.UNKNOWN_GROUND_TOOL: "only the ground tool at the address of `out` is listened to there",
    Refusal.TOO_MANY_GROUND_TOOLS: "more ground tools on one port than there is room for",
    Refusal.GROUND_TOOL_UNKNOWN_TARGET: "a ground tool addresses a system that was never heard",
    Refusal.GROUND_TOOL_USES_VEHICLE_ID: "a ground tool uses a vehicle's system id: give it its own (255 by custom)",
    Refusal.GROUND_TOOL_AIDING: "a ground tool sends positions to a vehicle that we aid: stop one of the two",
    Refusal.FORWARD_ADDRESS_CONFLICT: "frames under a vehicle's system id from another address than its own are not forwarded",
    Refusal.RANGE_OF_ANOTHER: "RANGING_BEACON for another vehicle than its sender: it is to reach that vehicle alone",
    Refusal.RATE_LIMITED: "more than senders.bytes_per_s: a flood, or a busy router",
    Refusal.ROUTE_TABLE_FULL: "more senders than there is room for: is something flooding the link?",
}
_MAX_REASONS_IN_A_LINE = 6
"""Chosen: a line that is still read; all of them are on the page and in the metrics."""


class Refusals:
    """Adds up several counts: totals for observers, and now and then a line for the operator."""

    def __init__(self, sources: Sequence[Mapping[str, int]]) -> None:
        self._sources = sources
        self._reported: Counter[str] = Counter()

    def totals(self) -> dict[str, int]:
        """How often each reason occurred since the start, routine ones left out."""
        return dict(self._sum())

    def pending_warning(self) -> str | None:
        """What has been refused since the last call, in one line with remedies; None where nothing was."""
        now = self._sum()
        grown = now - self._reported
        self._reported = now
        for reason in _WITHOUT_WARNING:
            del grown[reason]
        if not grown:
            return None
        items = ", ".join(f"{reason} {times}" for reason, times in grown.most_common(_MAX_REASONS_IN_A_LINE))
        remedies = "; ".join(_REMEDIES[reason] for reason in grown if reason in _REMEDIES)
        return f"refused on the links: {items}" + (f" ({remedies})" if remedies else "")

    def _sum(self) -> Counter[str]:
        total: Counter[str] = Counter()
        for source in self._sources:
            total.update({str(reason): times for reason, times in source.items() if reason not in _ROUTINE})
        return total
