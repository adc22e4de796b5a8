"""Node ids: a vehicle's is its MAVLink system id, a station's is negative, so that the two never meet.

Station ids, as RANGING_BEACON has them, are 0 to 65535. Estimators and integrity take either for an end of a range.
"""

from __future__ import annotations

from collections.abc import Sequence

MAX_SYSTEM_ID = 0xFFFF_FFFF
"""System ids are getting 32 bits (MAVLink RFC 20). Nothing of ours that holds one has less."""
LARGEST_READ_SYSTEM_ID = 255
"""Frames whose header has a larger one are counted, not read: a setting that names one is a mistake."""
MAX_STATION_ID = 65_535
"""RANGING_BEACON.beacon_id is a uint16_t."""


def is_system_id(number: int) -> bool:
    """Return whether a number is a vehicle's system id; 0 addresses everybody."""
    return 1 <= number <= MAX_SYSTEM_ID


def station_node(station_id: int) -> int:
    """Return the node id of a station."""
    return -1 - station_id


def is_station(node: int) -> bool:
    """Return whether a node is a station."""
    return node < 0


def station_id_of(node: int) -> int:
    """Return the id of a station by its node id."""
    return -1 - node


def node_name(node: int) -> str:
    """Return a node in words for people: a vehicle's system id alone, or `station 3`."""
    return f"station {station_id_of(node)}" if is_station(node) else str(node)


def node_names(nodes: Sequence[int]) -> str:
    """Return the names of some nodes in a sentence: "2, 3 and station 7"."""
    names = [node_name(node) for node in nodes]
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def untested_text(untested: Sequence[int], vehicle: int) -> str:
    """Return what the ranges of a vehicle cannot test, in words, by `ProtectionLevel.untested`."""
    others = [node for node in untested if node != vehicle]
    positions = f"the position{'s' if len(others) > 1 else ''} of {node_names(others)}" if others else ""
    return " and ".join(filter(None, ("its ranging device" if vehicle in untested else "", positions)))
