"""The true position of a simulated vehicle: for display and scoring only, never a message of the core's."""

from __future__ import annotations

from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.mavlink import checks
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.dialect import MESSAGE_CLASSES
from gcs_coloc.mavlink.framing import RawFrame

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
    """The truth in a frame: SIMSTATE (164) or SIM_STATE (108) of an autopilot; None in any other, or where it is impossible."""
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
