"""The messages that carry a range: PEER_RANGE, RANGING_BEACON, DEBUG_VECT and NAMED_VALUE_FLOAT.

PEER_RANGE is packed by hand from its definition, not by the service's code, so that the wire is checked from two sides. Frame
layout: https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development
from pymavlink.generator.mavcrc import x25crc

PEER_RANGE_ID = 181600  # source: the dialect of gcs-coloc
_PEER_RANGE_CRC_EXTRA = 116  # source: the same; a test derives it from the definition
_UINT32_UNKNOWN = 0xFFFFFFFF  # MAVLink's unknown of the type
_INT32_UNKNOWN = 0x7FFFFFFF  # the same
_ALT_MSL = 1


def peer_range_frame(
    sysid: int,
    compid: int,
    frame_sequence: int,
    time_usec: int,
    peer_system: int,
    range_m: float,
    range_std_m: float,
    sequence: int,
    quality: int = 255,
    device_id: int = 0,
    station: int | None = None,
) -> bytes:
    """Pack PEER_RANGE (181600).

    `time_usec` is on the sender's clock. `range_std_m` is 0 where unknown, `quality` in % or 255.

    To a `station` (id) `peer_system` is 0, and the extension fields peer_type and peer_station name it.
    """
    fields = time_usec, range_m, range_std_m, sequence & 0xFFFF, peer_system, quality, device_id
    payload = struct.pack("<QffHBBBBH", *fields, int(station is not None), station or 0)
    payload = payload.rstrip(b"\0") or payload[:1]
    head = struct.pack("<BBBBBB", len(payload), 0, 0, frame_sequence & 0xFF, sysid, compid) + PEER_RANGE_ID.to_bytes(3, "little")
    crc = x25crc(head + payload)
    crc.accumulate(bytes([_PEER_RANGE_CRC_EXTRA]))
    return b"\xfd" + head + payload + struct.pack("<H", crc.crc)


def ranging_beacon(
    time_usec: int,
    peer_system: int,
    range_m: float,
    range_std_m: float,
    sequence: int,
    station: int | None = None,
    station_lla: tuple[float, float, float] | None = None,
) -> Any:
    """Build RANGING_BEACON (513).

    `station_lla` is the position of the `station` (degrees, m above mean sea level). Without one, `beacon_id` is the
    peer's system id, and the position is marked unknown.
    """
    lat, lon, alt_m = _INT32_UNKNOWN, _INT32_UNKNOWN, math.nan
    if station_lla is not None:
        lat, lon, alt_m = round(station_lla[0] * 1e7), round(station_lla[1] * 1e7), station_lla[2]
    return development.MAVLink_ranging_beacon_message(
        time_usec=time_usec,
        target_system=0,
        target_component=0,
        beacon_id=peer_system if station is None else station,
        range=round(range_m * 1000.0),
        lat=lat,
        lon=lon,
        alt=alt_m,
        alt_type=0 if station_lla is None else _ALT_MSL,
        hacc_est=_UINT32_UNKNOWN,
        vacc_est=_UINT32_UNKNOWN,
        carrier_freq=0,
        range_accuracy=round(range_std_m * 1000.0) if range_std_m > 0.0 else _UINT32_UNKNOWN,
        sequence=sequence & 0xFF,
        status=0,
    )


def debug_range(time_usec: int, peer_system: int, range_m: float, range_std_m: float, station: int | None = None) -> Any:
    """Build a range as DEBUG_VECT, named as `named_range` does.

    x is the range, y its standard deviation (0 unknown).
    """
    return mavlink.MAVLink_debug_vect_message(_name(peer_system, station).encode(), time_usec, range_m, range_std_m, -1.0)


def named_range(boot_s: float, peer_system: int, range_m: float, station: int | None = None) -> Any:
    """Build a range as NAMED_VALUE_FLOAT.

    Its name is "RNG" and the peer's system id, or "STN" and the station's id.
    """
    time_boot_ms = int(boot_s * 1000.0) & 0xFFFFFFFF
    return mavlink.MAVLink_named_value_float_message(time_boot_ms, _name(peer_system, station).encode(), range_m)


def _name(peer_system: int, station: int | None) -> str:
    return f"RNG{peer_system}" if station is None else f"STN{station}"
