"""Inbound messages of vehicles, frozen, with units in the names of their fields.

Others stand in `control` and `outbound`.

Conventions for all of them, those of `control` and `outbound` as well:

- `sysid` is the MAVLink system id of the vehicle the message is about.
- `received_at_s` is the arrival time on the service's clock (seconds, monotonic, arbitrary epoch).
- `boot_s` is the sender's own clock, seconds since its boot; `None` where the wire message carries no time.
- Angles are radians except latitudes and longitudes, which are degrees (WGS 84).
- Altitudes are metres above mean sea level, velocities are metres per second in north, east, down.
- An optional field is `None` where the sender marked it as unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum

from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.messages.control import ControlInput


class Autopilot(Enum):
    """The autopilot family that a HEARTBEAT announces; it decides which aid the vehicle can take."""

    ARDUPILOT = "ArduPilot"
    PX4 = "PX4"
    OTHER = "other"


class TimeBase(StrEnum):
    """The clock in which a range's measuring time is given."""

    BOOT = "boot"
    UNIX = "unix"
    SERVICE = "service"


@dataclass(frozen=True, slots=True)
class FromVehicle:
    """What a vehicle says of itself."""

    sysid: int
    received_at_s: float


@dataclass(frozen=True, slots=True)
class Heartbeat(FromVehicle):
    """HEARTBEAT (0) of an autopilot component.

    Heartbeats of ground stations and peripherals are not turned into this.

    `winged`: the vehicle is of a type that flies along its nose and turns by banking. `mode`: the name of its flight mode.
    `vehicle_class`: how it moves, None for other types.
    """

    autopilot: Autopilot
    armed: bool
    winged: bool
    mode: str | None = None
    vehicle_class: VehicleClass | None = None


@dataclass(frozen=True, slots=True)
class GlobalPosition(FromVehicle):
    """GLOBAL_POSITION_INT (33): the autopilot's own position estimate.

    For a vehicle without GPS this is dead reckoning or an echo of what we sent: only its altitude is evidence then.
    """

    boot_s: float
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    vn_mps: float
    ve_mps: float
    vd_mps: float


FIX_3D = 3
"""GPS_FIX_TYPE_3D_FIX; from it on a `fix_type` is a position in three dimensions."""


@dataclass(frozen=True, slots=True)
class GpsReceiver(FromVehicle):
    """GPS_RAW_INT (24, `receiver` 0) or GPS2_RAW (124, `receiver` 1): what one receiver says of itself.

    Without a fix (`fix_type` below 2) its position is 0, 0, 0. `h_acc_m`, `v_acc_m` and `speed_acc_mps` are 1-sigma; ArduPilot
    leaves them at their last good value when a fix is lost. `fixed_boot_s` is when the autopilot heard of the fix (`time_usec`).
    `geoid_height_m` is mean sea level's height above the WGS 84 ellipsoid there. `velocity_ne_mps` is the receiver's own velocity
    over ground, north and east, by the Doppler shift.
    """

    receiver: int
    fix_type: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    satellites: int | None
    hdop: float | None
    h_acc_m: float | None
    v_acc_m: float | None
    speed_acc_mps: float | None
    fixed_boot_s: float | None = None
    geoid_height_m: float | None = None
    velocity_ne_mps: tuple[float, float] | None = None


class Interference(Enum):
    """What a receiver says of jamming or of spoofing.

    GPS_JAMMING_STATE and GPS_SPOOFING_STATE, which number alike.

    MITIGATED of spoofing is what some receivers mean by "indicated": one of their tests tells it, another does not.
    """

    UNKNOWN = 0
    NONE = 1
    MITIGATED = 2
    DETECTED = 3


@dataclass(frozen=True, slots=True)
class ReceiverIntegrity(FromVehicle):
    """GNSS_INTEGRITY (441): what one receiver says of interference with it and of its own test (RAIM).

    `receiver` is the instance, as in GpsReceiver; PX4 tells of the receiver in use alone, under a number of its own.
    """

    receiver: int
    jamming: Interference
    spoofing: Interference
    raim_failed: bool


@dataclass(frozen=True, slots=True)
class SystemHealth(FromVehicle):
    """SYS_STATUS (1), the GPS bit (0x20) of its three sensor masks, and the battery's charge."""

    gps_present: bool
    gps_enabled: bool
    gps_healthy: bool
    battery_percent: int | None = None

    @property
    def gps_flags(self) -> tuple[bool, ...]:
        """What it says of the GPS: present, enabled, healthy."""
        return self.gps_present, self.gps_enabled, self.gps_healthy


@dataclass(frozen=True, slots=True)
class EkfStatus(FromVehicle):
    """EKF_STATUS_REPORT (193, ArduPilot) or ESTIMATOR_STATUS (230, PX4): the flags that matter here.

    Of PX4 alone, else None: `global_position_aided`: GNSS or an auxiliary position aids it; `horizontally_aided`: anything does
    that tells of horizontal position or velocity, as vision.
    """

    horizontal_position_absolute: bool
    constant_position_mode: bool
    gps_glitching: bool
    global_position_aided: bool | None = None
    horizontally_aided: bool | None = None

    @property
    def flags(self) -> tuple[bool | None, ...]:
        """All its flags."""
        own = self.horizontal_position_absolute, self.constant_position_mode, self.gps_glitching
        return *own, self.global_position_aided, self.horizontally_aided


@dataclass(frozen=True, slots=True)
class Attitude(FromVehicle):
    """ATTITUDE (30): roll, pitch and yaw of the body in radians; yaw from true north, clockwise."""

    boot_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Airspeed(FromVehicle):
    """VFR_HUD (74): calibrated or indicated airspeed. The wire message carries no time."""

    airspeed_mps: float


@dataclass(frozen=True, slots=True)
class VtolState(FromVehicle):
    """EXTENDED_SYS_STATE (245) of a vehicle that can hover and fly on wings: whether it is on its rotors.

    It is so from the transition back to them on; in that to its wings another propeller or a tilted rotor accelerates it.
    """

    on_rotors: bool


@dataclass(frozen=True, slots=True)
class Pressure(FromVehicle):
    """SCALED_PRESSURE (29): absolute air pressure by the vehicle's first barometer."""

    boot_s: float
    pressure_hpa: float


@dataclass(frozen=True, slots=True)
class SystemTime(FromVehicle):
    """SYSTEM_TIME (2): the sender's UNIX time (None until it has one) beside its boot time."""

    boot_s: float
    unix_s: float | None


@dataclass(frozen=True, slots=True)
class TimeSyncAnswer(FromVehicle):
    """TIMESYNC (111) in answer to a request: our time as echoed, and the sender's clock, in ns."""

    ts1_ns: int
    tc1_ns: int


@dataclass(frozen=True, slots=True)
class BeaconPosition:
    """The position of a station as a RANGING_BEACON (513) states it.

    `alt_m` is above mean sea level (`is_msl`) or above the WGS 84 ellipsoid; `None` unknown, as are the 1-sigmas.
    """

    lat_deg: float
    lon_deg: float
    alt_m: float | None
    is_msl: bool
    sigma_h_m: float | None
    sigma_v_m: float | None


@dataclass(frozen=True, slots=True)
class Beacon:
    """The station of a RANGING_BEACON (513): its id, and its position, None where that is not stated."""

    beacon_id: int
    position: BeaconPosition | None


@dataclass(frozen=True, slots=True)
class PeerRange(FromVehicle):
    """A slant range of a vehicle, from PEER_RANGE (181600), RANGING_BEACON (513) or a named value.

    `sysid` is the vehicle that measured and reports it, `peer` the node at the other end: a vehicle's system id or a station's
    node id (`core.stations.node_id`). `measured_at_s` is on the clock
    that `time_base` names, `None` where the wire message carries no time. `sigma_m` is `None` where it is unknown.
    `line_of_sight` is the sender's own hint: 0 certainly obstructed to 1 certainly clear, `None` unknown.
    `device_id` tells apart several ranging devices of one vehicle. `beacon` is what a RANGING_BEACON says of the other end.
    """

    peer: int
    range_m: float
    sigma_m: float | None
    measured_at_s: float | None
    time_base: TimeBase
    sequence: int | None
    line_of_sight: float | None
    device_id: int
    beacon: Beacon | None = None


class VehicleCommand(Enum):
    """A command whose result aiding branches on."""

    EXTERNAL_POSITION_ESTIMATE = "MAV_CMD_EXTERNAL_POSITION_ESTIMATE"
    ESTIMATOR_SENSOR_ENABLE = "MAV_CMD_ESTIMATOR_SENSOR_ENABLE"
    OTHER = "other"


class CommandOutcome(Enum):
    """What a vehicle made of a command: MAV_RESULT in words."""

    ACCEPTED = "accepted"
    TEMPORARILY_REJECTED = "temporarily rejected"
    DENIED = "denied"
    UNSUPPORTED = "unsupported"
    FAILED = "failed"
    IN_PROGRESS = "in progress"
    OTHER = "another result"


@dataclass(frozen=True, slots=True)
class CommandResult(FromVehicle):
    """COMMAND_ACK (77): what a vehicle made of a command."""

    command: VehicleCommand
    outcome: CommandOutcome


@dataclass(frozen=True, slots=True)
class GlobalOrigin(FromVehicle):
    """GPS_GLOBAL_ORIGIN (49): where the origin of a vehicle's local frame is."""

    lat_deg: float
    lon_deg: float
    alt_msl_m: float


@dataclass(frozen=True, slots=True)
class ParameterValue(FromVehicle):
    """PARAM_VALUE (22): one parameter of a vehicle as it stands; `kind` is its MAV_PARAM_TYPE."""

    name: str
    value: float
    kind: int


Inbound = FromVehicle | ControlInput
