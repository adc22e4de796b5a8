"""Control inputs: what the host, the operator and the links send. Conventions as in `inbound`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import NamedTuple

HOST_LATE_S = 0.25
"""Later than this a host falls behind. Chosen: two of ten positions a second come late; one with time to spare is late by some
0.01 s."""


@dataclass(frozen=True, slots=True)
class ClockReference:
    """What the host knows of UTC.

    UNIX time minus service clock, and whether the host's clock is disciplined.

    `utc_minus_service_s` is `None` where the host does not know UTC; GPS week and time of week are then left at 0 unless
    vehicles know it. `synchronised` is `None` where the host does not tell. `lag_s` is by how much it ran the service late at
    worst since its report before: what is heard by a link without stamps of arrival may be stamped late by that.
    """

    received_at_s: float
    utc_minus_service_s: float | None
    synchronised: bool | None = None
    lag_s: float = 0.0


NO_HEARTBEAT_YET = "no heartbeat of an autopilot heard yet"


class GpsOverride(Enum):
    """The operator's decision on a vehicle's GPS; AUTO gives the decision back to the state machine."""

    AUTO = "auto"
    FAILED = "failed"
    HEALTHY = "healthy"


class AidingOverride(Enum):
    """The operator's decision on aiding a vehicle.

    ON aids it whatever its GPS says, OFF never does. AUTO leaves it to its GPS health.
    """

    AUTO = "auto"
    ON = "on"
    OFF = "off"


class PrimaryOverride(Enum):
    """The operator's decision on the parameter GPS_PRIMARY of an aided vehicle.

    OURS is the receiver that we feed, OWN what it was before. AUTO leaves it to the setting `switch_primary`.
    """

    AUTO = "auto"
    OURS = "ours"
    OWN = "own"


Override = GpsOverride | AidingOverride | PrimaryOverride
OVERRIDE_KINDS: Mapping[str, type[Override]] = {"gps": GpsOverride, "aiding": AidingOverride, "gps_primary": PrimaryOverride}
"""The kinds of override by their names on the page, in recordings and between two services."""


class CommandSource(StrEnum):
    """Where an operator's command came from. The value stands in recordings, on the page and in MQTT."""

    PAGE = "page"
    MQTT = "MQTT"
    FLAG = "flag"
    CONFIGURATION = "configuration"
    OTHER_SERVICE = "other service"


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """The operator's decision on one vehicle, over all evidence. `source` is None in recordings of 0.1."""

    sysid: int
    received_at_s: float
    override: Override
    source: CommandSource | None = None


class RouteBlock(StrEnum):
    """Why nothing may be sent to a vehicle. Its value stands in recordings."""

    NO_HEARTBEAT = "no_heartbeat"
    """No autopilot's heartbeat of it was heard yet."""
    SHARED_ADDRESS = "shared_address"
    """Several vehicles are heard from its address: only what its target alone heeds is sent, and GPS_INPUT has no target."""


ALL_WOULD_USE_IT = "GPS_INPUT has no target field, nor does PX4 heed a position's: all of them would use it"
"""Why a position goes to no address that vehicles share, in words for the operator."""
OWN_ADDRESS = (
    "give each vehicle its own UDP stream to us, from its own port, or its own --link; an ArduPilot can be aided there by "
    "external_position, whose commands their target alone heeds"
)
"""The remedy."""


@dataclass(frozen=True, slots=True)
class RouteReport:
    """What the link layer knows about reaching a vehicle.

    `blocked` says why nothing may be sent to it, or is None.

    `shared_with`: the system ids of the other vehicles at its address.
    """

    sysid: int
    received_at_s: float
    blocked: RouteBlock | None
    shared_with: tuple[int, ...] = ()

    @property
    def wording(self) -> str | None:
        """Why nothing may be sent to the vehicle, and the remedy, in words for the operator."""
        if self.blocked is not RouteBlock.SHARED_ADDRESS:
            return NO_HEARTBEAT_YET if self.blocked is RouteBlock.NO_HEARTBEAT else None
        sharing = f"vehicles {', '.join(map(str, self.shared_with))} and {self.sysid}" if self.shared_with else "several vehicles"
        return f"{sharing} are heard from one address (a router?), and {ALL_WOULD_USE_IT}; {OWN_ADDRESS}"


@dataclass(frozen=True, slots=True)
class TransmitDisabled:
    """From now on nothing that the engine has to send reaches anybody.

    How vehicles answer to it is not to be judged.

    So it is when somebody else's recording is replayed, or a flight of ours in another way than it was flown.
    """

    received_at_s: float


class SwitchedReceiver(NamedTuple):
    """A vehicle whose own receiver was switched out of use by a service, and what restores it.

    `before` and `kind` (MAV_PARAM_TYPE) are those of its GPS_PRIMARY; both None where a command restores it, as on PX4.
    """

    sysid: int
    before: float | None = None
    kind: int | None = None


@dataclass(frozen=True, slots=True)
class HoldBack:
    """From now on what changes what vehicles do is held back (`held`), or is sent again.

    It is held back while the other service sends it.

    All else goes on: how vehicles answer to what the other one sends is judged as if it were ours.
    """

    received_at_s: float
    held: bool


@dataclass(frozen=True, slots=True)
class SwitchedByOther:
    """The other service switched a vehicle's receiver while ours is held back; not `held`: no longer."""

    received_at_s: float
    receiver: SwitchedReceiver
    held: bool


@dataclass(frozen=True, slots=True)
class ForeignGpsInput:
    """GPS_INPUT (232) that somebody else sends: system `sysid`, for the receiver instance `gps_id`.

    The message has no target field: `vehicle` is whom it reaches, as the link layer knows; None where that is not known.
    """

    sysid: int
    received_at_s: float
    gps_id: int
    vehicle: int | None = None


ControlInput = ForeignGpsInput | ClockReference | OperatorCommand | RouteReport | TransmitDisabled | HoldBack | SwitchedByOther
"""What the host, the operator and the links say: no sign of life of a vehicle."""
