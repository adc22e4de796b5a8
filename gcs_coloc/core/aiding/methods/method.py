"""The base of an aiding method, which builds the messages that aid one vehicle from one estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gcs_coloc.core.aiding.inhibit import Inhibit
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, NoEstimate, RangeMeasurement
from gcs_coloc.core.messages.inbound import CommandResult, GlobalOrigin
from gcs_coloc.core.messages.outbound import AidingMessage, Notice
from gcs_coloc.core.reasons import CoreRefusal


@dataclass(frozen=True, slots=True)
class MethodContext:
    """What an aiding method of one vehicle is made from.

    `refused` counts what vehicles refuse. `origin` returns what the vehicle has reported of its local frame's origin.
    """

    sysid: int
    first_heard_s: float
    settings: AidingSettings
    parameters: Parameters
    refused: Counter[CoreRefusal]
    origin: Callable[[], GlobalOrigin | None]


@dataclass(frozen=True, slots=True)
class FixInputs:
    """What earlier stages know of a vehicle at the time of one message.

    Times are on the service's clock, s.
    `is_trusted`: its own receiver is in its estimate. `has_air_data`: airspeed and bank show how it moves. `is_aligned`: its EKF
    reports an absolute position. `one_way_delay_s`: the least delay of its link. `range_sigma_m`: 1-sigma of its ranges of late.
    `median_nis`, `range_jump_m`: how its ranges fit. `ranges` are its vetted ones since the last message, `locate_node` estimates
    any vehicle or station at a time, `boot_s` is a service time on the vehicle's own clock, None where unknown.
    """

    is_trusted: bool
    has_air_data: bool
    is_aligned: bool
    one_way_delay_s: float | None
    range_sigma_m: float | None
    median_nis: float | None
    range_jump_m: float | None
    ranges: Sequence[RangeMeasurement]
    locate_node: Callable[[int, float], Estimate | NoEstimate]
    boot_s: Callable[[float], float | None]


@dataclass(frozen=True, slots=True)
class Moment:
    """What a method may send at one time. Times are on the service's clock, s.

    `where` is the estimate for the time that the method's `age_s` wants, `arrives_s` when what is sent now arrives, `inhibit` why
    no fix may be stated. `standby`: the vehicle's own receiver is in use. `transmits`: what is built is sent, so that an answer
    may be expected.
    """

    now_s: float
    arrives_s: float
    frame: LocalFrame | None
    utc_minus_service_s: float | None
    where: Estimate | NoEstimate
    inhibit: Inhibit | None
    known: FixInputs
    standby: bool
    transmits: bool

    def unix_us(self, at_s: float) -> int:
        """A service time as UNIX time in microseconds, 0 where that is not known."""
        return round((at_s + self.utc_minus_service_s) * 1e6) if self.utc_minus_service_s is not None else 0


class AidingMethod(ABC):
    """One method of aiding one vehicle.

    Where it says no more, its message cannot tell that there is no position, and no command is sent.
    """

    def __init__(self, context: MethodContext) -> None:
        self._sysid = context.sysid

    @property
    def age_s(self) -> float:
        """How old the vehicle takes the position to be when the message arrives, s."""
        return 0.0

    @abstractmethod
    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """Build the messages that are due now; called `rate_hz` times a second."""

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """Build the last messages, after which nothing comes."""
        return []

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """Add the vehicle's answer to a command."""
        del result
        return []

    @abstractmethod
    def with_fix(self) -> str:
        """Return what is sent while there is a fix, in words."""

    def without_fix(self) -> str:
        """Return what is sent while there is none, in words."""
        return "nothing"
