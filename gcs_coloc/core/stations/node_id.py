"""Node ids: a vehicle's is its MAVLink system id, a station's is negative, so that the two never meet.

System ids may grow beyond 255 (MAVLink RFC 20); station ids, as RANGING_BEACON has them, are 0 to 65535. Estimators and integrity
take either for an end of a range.
"""

from __future__ import annotations

MAX_STATION_ID = 65_535
"""RANGING_BEACON.beacon_id is a uint16_t."""


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
