"""The protocol of an aiding method, which builds the messages that aid one vehicle.

A method builds them from one estimate. The fix policy decides whether that may be stated.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from gcs_coloc.core.aiding.inhibit import Inhibit
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.aiding.vetted_ranges import VettedRange
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, NoEstimate, NoEstimateReason, Unlocated
from gcs_coloc.core.messages.inbound import CommandResult, GlobalOrigin
from gcs_coloc.core.messages.outbound import AidingMessage, Notice
from gcs_coloc.core.reasons import CoreRefusal


@dataclass(frozen=True, slots=True)
class MethodContext:
    """What an aiding method of one vehicle is made from.

    `refused` counts what vehicles refuse. `origins` are the origins that vehicles report of their local frames, by system id.
    """

    sysid: int
    first_heard_s: float
    settings: AidingSettings
    parameters: Parameters
    refused: Counter[CoreRefusal]
    origins: Mapping[int, GlobalOrigin]


def nowhere(node: int, at_s: float) -> NoEstimate:
    """Return that a node is not located."""
    return NoEstimate(node, at_s, Unlocated(NoEstimateReason.NOT_LOCATED))


def no_clock(at_s: float) -> None:
    """Return that a vehicle's clock is not known."""
    del at_s


@dataclass(frozen=True, slots=True)
class Moment:
    """What a method may send at one time. Times are on the service's clock, s.

    `where` is the estimate for the time that the method's `age_s` wants, `arrives_s` when what is sent now arrives, `inhibit` why
    no fix may be stated. `range_sigma_m` is the 1-sigma of the vehicle's ranges of late. `standby`: the vehicle's own receiver is
    in use. `is_aligned`: its EKF reports an absolute position. `transmits`: what is built is sent, so that an answer may be
    expected. `ranges` are the vehicle's vetted ones since the last moment, `locate_node` estimates any vehicle or station at a
    time, `boot_s` is a service time on the vehicle's own clock, None where unknown.
    """

    now_s: float
    arrives_s: float
    frame: LocalFrame | None
    utc_minus_service_s: float | None
    where: Estimate | NoEstimate
    inhibit: Inhibit | None
    range_sigma_m: float | None
    standby: bool
    is_aligned: bool = False
    transmits: bool = True
    ranges: Sequence[VettedRange] = ()
    locate_node: Callable[[int, float], Estimate | NoEstimate] = nowhere
    boot_s: Callable[[float], float | None] = no_clock

    def unix_us(self, at_s: float) -> int:
        """A service time as UNIX time in microseconds, 0 where that is not known."""
        return round((at_s + self.utc_minus_service_s) * 1e6) if self.utc_minus_service_s is not None else 0


class AidingMethod(Protocol):
    """One method of aiding one vehicle."""

    @property
    def age_s(self) -> float:
        """How old the vehicle takes the position to be when the message arrives, s."""

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """Build the messages that are due now; called `rate_hz` times a second."""

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """Build the last messages, after which nothing comes."""

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """Add the vehicle's answer to a command."""

    def with_fix(self) -> str:
        """Return what is sent while there is a fix, in words."""

    def without_fix(self) -> str:
        """Return what is sent while there is none, in words."""
