"""What the host, the operator and the links tell the engine. Conventions as in `messages`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gcs_coloc.core.messages.aiding import ForeignGpsInput


@dataclass(frozen=True, slots=True)
class ClockReference:
    """What the host knows of UTC: UNIX time minus service clock, and whether the host's clock is disciplined.

    `utc_minus_service_s` is `None` where the host does not know UTC; GPS week and time of week are then left at 0 unless
    vehicles know it. `synchronised` is `None` where the host does not tell.
    """

    received_at_s: float
    utc_minus_service_s: float | None
    synchronised: bool | None = None


class GpsOverride(Enum):
    """The operator's decision on a vehicle's GPS; AUTO gives the decision back to the state machine."""

    AUTO = "auto"
    FAILED = "failed"
    HEALTHY = "healthy"


class AidingOverride(Enum):
    """The operator's decision on aiding a vehicle: ON whatever its GPS says, OFF never; AUTO leaves it to its GPS."""

    AUTO = "auto"
    ON = "on"
    OFF = "off"


class PrimaryOverride(Enum):
    """The operator's decision on GPS_PRIMARY of an aided vehicle: OURS our receiver, OWN what it was; AUTO as it is set."""

    AUTO = "auto"
    OURS = "ours"
    OWN = "own"


Override = GpsOverride | AidingOverride | PrimaryOverride


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """One decision of the operator on one vehicle; it wins over all evidence until withdrawn."""

    sysid: int
    received_at_s: float
    override: Override


@dataclass(frozen=True, slots=True)
class RouteReport:
    """What the link layer knows about reaching a vehicle: `blocked` says why nothing may be sent to it, or is None."""

    sysid: int
    received_at_s: float
    blocked: str | None


@dataclass(frozen=True, slots=True)
class TransmitDisabled:
    """From now on nothing that the engine has to send reaches anybody: how vehicles answer to it is not to be judged.

    So it is when somebody else's recording is replayed, or a flight of ours in another way than it was flown.
    """

    received_at_s: float


ControlInput = ForeignGpsInput | ClockReference | OperatorCommand | RouteReport | TransmitDisabled
"""What the host, the operator and the links say: no sign of life of a vehicle."""
