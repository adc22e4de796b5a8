"""Whom a message is addressed to: read where its definition has the target fields, without decoding the rest."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from gcs_coloc.mavlink.dialect import MESSAGE_CLASSES
from gcs_coloc.mavlink.framing import RawFrame


class Target(NamedTuple):
    """A system and a component of it; 0 is all of them."""

    sysid: int
    compid: int


EVERYBODY = Target(0, 0)

_SYSTEM_FIELDS = ("target_system", "target")  # MANUAL_CONTROL alone has the second
_COMPONENT_FIELD = "target_component"
_FIELD_FORMAT = re.compile(r"\d*[a-zA-Z]")


def _offsets(message_class: Any) -> tuple[int, int | None] | None:
    """Where in the payload the target system and component stand, bytes; None where the message has no target."""
    at, places = 0, {}
    formats = _FIELD_FORMAT.findall(message_class.unpacker.format.lstrip("<"))
    for name, field_format in zip(message_class.ordered_fieldnames, formats, strict=True):
        places[name] = at
        at += struct.calcsize(f"<{field_format}")
    for name in _SYSTEM_FIELDS:
        if name in places:
            return places[name], places.get(_COMPONENT_FIELD)
    return None


_OFFSETS: Mapping[int, tuple[int, int | None]] = MappingProxyType(
    {number: found for number, cls in MESSAGE_CLASSES.items() if (found := _offsets(cls)) is not None}
)


def target_of(raw: RawFrame) -> Target:
    """Whom a frame is addressed to; everybody where its message has no target, or is in no dialect of ours."""
    offsets = _OFFSETS.get(raw.message_id)
    if offsets is None:
        return EVERYBODY
    system_at, component_at = offsets
    return Target(_byte(raw.payload, system_at), _byte(raw.payload, component_at) if component_at is not None else 0)


def _byte(payload: bytes, at: int) -> int:
    # MAVLink 2 cuts off trailing zeros.
    return payload[at] if at < len(payload) else 0
