"""The four messages by which a vehicle may report a range to a peer, each converted to a PeerRange.

Every function takes the sender's system id, the arrival time and the payload's values in wire order.
docs/reference/peer-range.md describes them for senders.
"""

from __future__ import annotations

import re
from typing import Any

from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.mavlink import checks
from gcs_coloc.mavlink.checks import InvalidValueError
from gcs_coloc.mavlink.refusals import Field

UINT32_MAX = 0xFFFFFFFF
QUALITY_UNKNOWN = 255

_RANGE_NAME = re.compile(rb"RNG(\d+)")


def peer_range(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange:
    """PEER_RANGE (181600)."""
    time_usec, distance, range_std, sequence, peer, quality, device_id = values
    measured_at_s, time_base = _measuring_time(time_usec)
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer_sysid=checks.peer_sysid(peer, sysid, Field.PEER_SYSTEM),
        range_m=checks.range_m(distance, Field.RANGE),
        sigma_m=checks.range_sigma_m(range_std, Field.RANGE_STD),
        measured_at_s=measured_at_s,
        time_base=time_base,
        sequence=sequence,
        line_of_sight=None if quality == QUALITY_UNKNOWN else _probability(quality, Field.QUALITY),
        device_id=device_id,
    )


def ranging_beacon(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange:
    """RANGING_BEACON (513): the sender is the vehicle that measured, `beacon_id` the peer's system id.

    The position of the beacon in the message is not used: peers report their positions themselves.
    """
    time_usec, range_mm, _lat, _lon, _alt, _hacc, _vacc, range_accuracy_mm, beacon_id, _carrier, *rest = values
    _target_system, _target_component, _alt_type, sequence, _status = rest
    measured_at_s, time_base = _measuring_time(time_usec)
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer_sysid=checks.peer_sysid(beacon_id, sysid, Field.BEACON_ID),
        range_m=checks.range_m(range_mm / 1e3, Field.RANGE),
        sigma_m=None if range_accuracy_mm == UINT32_MAX else checks.range_sigma_m(range_accuracy_mm / 1e3, Field.RANGE_ACCURACY),
        measured_at_s=measured_at_s,
        time_base=time_base,
        sequence=sequence,
        line_of_sight=None,
        device_id=0,
    )


def named_value_float(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange | None:
    """NAMED_VALUE_FLOAT (251) with the name RNG<peer's system id>, value in metres; None for any other name."""
    boot_ms, value, name = values
    peer = _peer_of_name(name)
    if peer is None:
        return None
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer_sysid=checks.peer_sysid(peer, sysid, Field.NAME),
        range_m=checks.range_m(value, Field.VALUE),
        sigma_m=None,
        measured_at_s=boot_ms / 1e3 if boot_ms else None,
        time_base=TimeBase.BOOT if boot_ms else TimeBase.SERVICE,
        sequence=None,
        line_of_sight=None,
        device_id=0,
    )


def debug_vect(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> PeerRange | None:
    """DEBUG_VECT (250) with the name RNG<peer's system id>: x range m, y sigma m (0 unknown), z quality % (negative unknown)."""
    time_usec, x, y, z, name = values
    peer = _peer_of_name(name)
    if peer is None:
        return None
    measured_at_s, time_base = _measuring_time(time_usec)
    return PeerRange(
        sysid=sysid,
        received_at_s=received_at_s,
        peer_sysid=checks.peer_sysid(peer, sysid, Field.NAME),
        range_m=checks.range_m(x, Field.X),
        sigma_m=checks.range_sigma_m(y, Field.Y),
        measured_at_s=measured_at_s,
        time_base=time_base,
        sequence=None,
        line_of_sight=None if z < 0.0 else _probability(z, Field.Z),
        device_id=0,
    )


def _peer_of_name(name: bytes) -> int | None:
    matched = _RANGE_NAME.fullmatch(name.split(b"\0", 1)[0])
    return int(matched[1]) if matched else None


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
