"""The four messages that report a range, each converted to a PeerRange.

The range is from a vehicle to another vehicle or to a station.

Every function takes the sender's system id, the arrival time and the payload's values in wire order.
docs/reference/peer-range.md describes them for senders.
"""

from __future__ import annotations

import math
import re
from typing import Any

from gcs_coloc.core.messages.inbound import Beacon, BeaconPosition, PeerRange, TimeBase
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.mavlink import checks
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.refusals import Field

INT32_MAX, UINT32_MAX = 0x7FFFFFFF, 0xFFFFFFFF
QUALITY_UNKNOWN = 255  # source: PEER_RANGE.quality
_ALT_WGS84, _ALT_MSL = 0, 1
"""RANGING_BEACON_ALT_TYPE."""
PEER_IS_STATION = 1
"""PEER_TYPE_STATION."""

_RANGE_NAME = re.compile(rb"(RNG|STN)(\d+)")


def peer_range(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange:
    """PEER_RANGE (181600)."""
    time_usec, distance, range_std, sequence, peer, quality, device_id, peer_type, station_id, wide_peer = values
    if peer_type > PEER_IS_STATION:
        raise InvalidValueError(Field.PEER_TYPE)
    if peer and wide_peer:
        raise InvalidValueError(Field.PEER_SYSTEM_ID)
    measured_at_s, time_base = _measuring_time(time_usec)
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer=station_node(station_id)
        if peer_type == PEER_IS_STATION
        else checks.peer_sysid(peer or wide_peer, sysid, Field.PEER_SYSTEM),
        range_m=checks.range_m(distance, Field.RANGE),
        sigma_m=checks.range_sigma_m(range_std, Field.RANGE_STD),
        measured_at_s=measured_at_s,
        time_base=time_base,
        sequence=sequence,
        line_of_sight=None if quality == QUALITY_UNKNOWN else _probability(quality, Field.QUALITY),
        device_id=device_id,
    )


def ranging_beacon(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange:
    """RANGING_BEACON (513): the sender is the vehicle that measured, `beacon_id` a station's id.

    What the core makes of a message without the station's position depends on the settings.
    """
    time_usec, range_mm, lat_e7, lon_e7, alt_m, hacc_mm, vacc_mm, range_accuracy_mm, beacon_id, _carrier, *rest = values
    _target_system, _target_component, alt_type, sequence, _status = rest
    measured_at_s, time_base = _measuring_time(time_usec)
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer=station_node(beacon_id),
        range_m=checks.range_m(range_mm / 1e3, Field.RANGE),
        sigma_m=None if range_accuracy_mm == UINT32_MAX else checks.range_sigma_m(range_accuracy_mm / 1e3, Field.RANGE_ACCURACY),
        measured_at_s=measured_at_s,
        time_base=time_base,
        sequence=sequence,
        line_of_sight=None,
        device_id=0,
        beacon=Beacon(beacon_id, _beacon_position((lat_e7, lon_e7), alt_m, alt_type, hacc_mm, vacc_mm)),
    )


def _beacon_position(place_e7: tuple[int, int], alt_m: float, alt_type: int, hacc_mm: int, vacc_mm: int) -> BeaconPosition | None:
    """Return the position of a RANGING_BEACON; None where latitude and longitude are unknown (INT32_MAX)."""
    if place_e7 == (INT32_MAX, INT32_MAX):
        return None
    lat_deg, lon_deg = checks.latitude_longitude_deg(*place_e7)
    if alt_type not in (_ALT_WGS84, _ALT_MSL):
        raise InvalidValueError(Field.ALT_TYPE)
    return BeaconPosition(
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_m=None if math.isnan(alt_m) else checks.altitude_m(alt_m * 1e3),
        is_msl=alt_type == _ALT_MSL,
        sigma_h_m=_accuracy_m(hacc_mm),
        sigma_v_m=_accuracy_m(vacc_mm),
    )


def _accuracy_m(accuracy_mm: int) -> float | None:
    """Return an accuracy in m; None where it is unknown, as UINT32_MAX or 0 say."""
    return None if accuracy_mm in (0, UINT32_MAX) else accuracy_mm / 1e3


def named_value_float(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange | None:
    """NAMED_VALUE_FLOAT (251) named RNG<peer's system id> or STN<station's id>, in metres.

    None for any other name.
    """
    boot_ms, value, name = values
    peer = _peer_of_name(name, sysid)
    if peer is None:
        return None
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer=peer,
        range_m=checks.range_m(value, Field.VALUE),
        sigma_m=None,
        measured_at_s=boot_ms / 1e3 if boot_ms else None,
        time_base=TimeBase.BOOT if boot_ms else TimeBase.SERVICE,
        sequence=None,
        line_of_sight=None,
        device_id=0,
    )


def debug_vect(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange | None:
    """DEBUG_VECT (250) named RNG<peer's system id> or STN<station's id>; None for any other name.

    x range m, y sigma m (0 unknown), z quality % (negative unknown).
    """
    time_usec, x, y, z, name = values
    peer = _peer_of_name(name, sysid)
    if peer is None:
        return None
    measured_at_s, time_base = _measuring_time(time_usec)
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer=peer,
        range_m=checks.range_m(x, Field.X),
        sigma_m=checks.range_sigma_m(y, Field.Y),
        measured_at_s=measured_at_s,
        time_base=time_base,
        sequence=None,
        line_of_sight=None if z < 0.0 else _probability(z, Field.Z),
        device_id=0,
    )


def _peer_of_name(name: bytes, sender: int) -> int | None:
    """Return the node that a named range is to; None where the name is no range's."""
    matched = _RANGE_NAME.fullmatch(name.split(b"\0", 1)[0])
    if matched is None:
        return None
    number = int(matched[2])
    is_vehicle = matched[1] == b"RNG"
    return checks.peer_sysid(number, sender, Field.NAME) if is_vehicle else checks.station_node_of(number, Field.NAME)


def _measuring_time(time_usec: int) -> tuple[float | None, TimeBase]:
    if time_usec == 0:
        return None, TimeBase.SERVICE
    if time_usec > checks.UNIX_TIME_TO_US:
        raise InvalidValueError(Field.TIME_USEC)
    return time_usec / 1e6, TimeBase.UNIX if time_usec >= checks.UNIX_TIME_FROM_US else TimeBase.BOOT


def _probability(percent: float, field: Field) -> float:
    if not 0.0 <= percent <= 100.0:
        raise InvalidValueError(field)
    return percent / 100.0
