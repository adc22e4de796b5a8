"""Reasons of the core: those that it states with numbers, those that refusals are counted by; wording."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Generic, TypeVar

DUPLICATE_ID_WORDING = "two autopilots use its system id; give each its own"
DOCTOR_NAMES_SETTINGS = "gcs-coloc doctor names the settings"
"""The remedy where an autopilot does not use what it is sent: its parameters are known there alone."""


def counted(count: int, noun: str) -> str:
    """Return a number with its noun, which takes an s where it is not one."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


class WordedReason(Enum):
    """A reason that a program branches on, with its wording.

    In the wording `{value}` is what was found, `{limit}` what is allowed, and `{detail}` other words.
    """

    def __init__(self, code: str, wording: str) -> None:
        self.code = code
        self.wording = wording


Reason = TypeVar("Reason", bound=WordedReason)


# Without slots: with them Python 3.11 cannot make one through a name for it with its type argument.
@dataclass(frozen=True)
class StatedReason(Generic[Reason]):
    """A reason with its numbers: what was found, the limit for it, and words from elsewhere."""

    reason: Reason
    value: float = 0.0
    limit: float = 0.0
    detail: str = ""

    @property
    def text(self) -> str:
        """The reason in words."""
        return self.reason.wording.format(value=self.value, limit=self.limit, detail=self.detail)


class CoreRefusal(StrEnum):
    """A reason that the core counts by. Its value is the `reason` label of the metric."""

    FLEET_FULL = "fleet_full"
    """A message of a vehicle beyond `max_vehicles`."""

    # Clocks: the sender's stamp jumps against the clock known so far, or is older than `max_age_s`.
    POSITION_CLOCK_JUMPED = "position_clock_jumped"
    POSITION_TOO_OLD = "position_too_old"
    PRESSURE_CLOCK_JUMPED = "pressure_clock_jumped"
    PRESSURE_TOO_OLD = "pressure_too_old"
    ATTITUDE_CLOCK_JUMPED = "attitude_clock_jumped"
    ATTITUDE_TOO_OLD = "attitude_too_old"
    SYSTEM_TIME_CLOCK_JUMPED = "system_time_clock_jumped"
    SYSTEM_TIME_TOO_OLD = "system_time_too_old"
    RANGE_CLOCK_JUMPED = "range_clock_jumped"
    RANGE_TOO_OLD = "range_too_old"
    RANGE_CLOCKS_FULL = "range_clocks_full"
    """More time bases and devices than a vehicle may have."""
    TIMESYNC_NOT_REQUESTED = "timesync_not_requested"
    TIMESYNC_TOO_OLD = "timesync_too_old"
    TIMESYNC_CONTRADICTORY = "timesync_contradictory"
    """No delay of the link explains it beside the answers before it."""
    TIMESYNC_OFF_BOOT_TIME = "timesync_off_boot_time"
    TIMESYNC_BEFORE_BOOT_TIME = "timesync_before_boot_time"
    """The vehicle has sent no boot time yet."""

    ATTITUDE_REPEATED = "attitude_repeated"
    """The attitude is the one before, to the last bit."""

    # Ranges
    RANGE_PEER_UNKNOWN = "range_peer_unknown"
    """The other end is no vehicle of the fleet."""
    BEACON_WITHOUT_POSITION = "ranging_beacon_without_position"
    """RANGING_BEACON without a position, of no station that has one."""
    BEACON_NO_VEHICLE = "ranging_beacon_no_vehicle"
    """Its id is to be a vehicle's system id and is none, or the sender's own."""
    STATION_UNKNOWN = "station_unknown"
    """A range to a station without a position."""
    STATION_HEIGHT_UNKNOWN = "station_height_unknown"
    """A station's stated position has no height above mean sea level."""
    STATION_CONTRADICTED = "station_contradicted"
    """A RANGING_BEACON puts a station elsewhere than it is known to be. A configured position counts, and the range is used."""
    STATIONS_FULL = "stations_full"
    """More stations are stated than there is room for."""
    RANGE_REPEATED = "range_repeated"
    """The ranging device repeats one value."""
    RANGE_JUMPED = "range_jumped"
    """The range has left its own predecessors faster than vehicles move: an outlier, or on a way around since."""

    # Integrity
    REACQUIRED_FIX_REJECTED = "reacquired_fix_rejected"
    """The receiver is back, but ranges or estimate contradict it."""

    # Answers to MAV_CMD_EXTERNAL_POSITION_ESTIMATE, by MAV_RESULT
    EXTERNAL_POSITION_REJECTED = "external_position_temporarily_rejected"
    EXTERNAL_POSITION_DENIED = "external_position_denied"
    EXTERNAL_POSITION_UNSUPPORTED = "external_position_unsupported"
    EXTERNAL_POSITION_FAILED = "external_position_failed"
    EXTERNAL_POSITION_OTHER = "external_position_other_result"
