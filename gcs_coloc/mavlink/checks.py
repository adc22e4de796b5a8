"""Checks that refuse values which no vehicle can mean.

Each returns the value that it checked, in the unit of the core's messages, or raises InvalidValueError.
"""

from __future__ import annotations

import math

from gcs_coloc.core.stations.node_id import MAX_STATION_ID, is_system_id, station_node
from gcs_coloc.mavlink.refusals import Field

ALTITUDE_MIN_M = -1000.0
"""Chosen: below the lowest land, the Dead Sea's shore at -430 m, with room for a barometer's error."""
ALTITUDE_MAX_M = 100_000.0
"""Chosen: the Karman line, the edge of space. Above it nothing flies on wings or rotors."""
PRESSURE_MIN_HPA, PRESSURE_MAX_HPA = 50.0, 1200.0  # 20 km to -1400 m in the standard atmosphere
SPEED_MAX_MPS = 1000.0
"""Chosen: three times the speed of sound."""
RANGE_MAX_M = 100_000.0
"""Chosen: beyond the reach of any ranging radio between small vehicles."""
ANGLE_MAX_RAD = 2.0 * math.pi + 1e-3
"""One turn, with room for the rounding of a float of 32 bits."""
UNIX_TIME_FROM_US = 1_000_000_000_000_000
"""September 2001. MAVLink times above it are UNIX times, below it times since boot (1e15 us are 31 years)."""
UNIX_TIME_TO_US = 4_102_444_800_000_000
"""The year 2100. Chosen: a later time is a broken clock or a broken message."""


class InvalidValueError(Exception):
    """A field of a message holds a value that is impossible. It never leaves this package."""

    def __init__(self, field: Field) -> None:
        super().__init__(field)
        self.field = field


def latitude_longitude_deg(lat_e7: int, lon_e7: int) -> tuple[float, float]:
    """Check a position in 1e-7 degrees and return it in degrees.

    0, 0 is refused: a receiver without a position sends it.
    """
    if lat_e7 == 0 and lon_e7 == 0:
        raise InvalidValueError(Field.LAT_LON_ZERO)
    if abs(lat_e7) > 900_000_000:
        raise InvalidValueError(Field.LAT)
    if abs(lon_e7) > 1_800_000_000:
        raise InvalidValueError(Field.LON)
    return lat_e7 / 1e7, lon_e7 / 1e7


def altitude_m(alt_mm: float) -> float:
    """Check an altitude in millimetres and return it in metres."""
    altitude = alt_mm / 1e3
    if not ALTITUDE_MIN_M <= altitude <= ALTITUDE_MAX_M:
        raise InvalidValueError(Field.ALT)
    return altitude


def pressure_hpa(pressure: float) -> float:
    """Check an absolute air pressure in hPa: from above mount Everest, with room, to below the Dead Sea."""
    if not PRESSURE_MIN_HPA <= pressure <= PRESSURE_MAX_HPA:
        raise InvalidValueError(Field.PRESS_ABS)
    return pressure


def speed_mps(speed: float, field: Field) -> float:
    """Check the magnitude of a speed in m/s."""
    if not 0.0 <= speed <= SPEED_MAX_MPS:
        raise InvalidValueError(field)
    return speed


def angle_rad(angle: float, field: Field) -> float:
    """Check an angle in radians: finite and within one turn either way."""
    if not abs(angle) <= ANGLE_MAX_RAD:
        raise InvalidValueError(field)
    return angle


def range_m(distance: float, field: Field) -> float:
    """Check a slant range in metres: above 0, up to `RANGE_MAX_M`."""
    if not 0.0 < distance <= RANGE_MAX_M:
        raise InvalidValueError(field)
    return distance


def range_sigma_m(sigma: float, field: Field) -> float | None:
    """Check the standard deviation of a range in metres; 0 means unknown."""
    if not 0.0 <= sigma <= RANGE_MAX_M:
        raise InvalidValueError(field)
    return sigma if sigma > 0.0 else None


def peer_sysid(peer: int, sender: int, field: Field) -> int:
    """Check the system id at the other end of a range: a system id, and not the sender's own."""
    if not is_system_id(peer) or peer == sender:
        raise InvalidValueError(field)
    return peer


def station_node_of(station_id: int, field: Field) -> int:
    """Check the id of the station at the other end of a range; return its node id."""
    if not 0 <= station_id <= MAX_STATION_ID:
        raise InvalidValueError(field)
    return station_node(station_id)
