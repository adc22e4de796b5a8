"""GPS health of one vehicle: a small explicit state machine that always has a reason in words.

    UNKNOWN -> HEALTHY -> SUSPECT -> FAILED -> RECOVERING -> HEALTHY
                  ^---------/           ^---------/

Evidence is what the vehicle's real receiver says in GPS_RAW_INT (in GPS2_RAW where we feed the first one), the GPS bit of
SYS_STATUS and the EKF's flags. The two last speak of the receiver *in use*: while the vehicle is aided they are an echo of our
own stream and count for nothing. The injected receiver never counts. What the service itself finds counts as well: a receiver
that repeats one position on the move (`motion_check`) is as good as lost, and so is one that the ranges show to lie
(`integrity`); a position other than the receiver's (`receiver_check`) is suspect. The operator's word wins over everything.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from gcs_coloc.core.gps_health.motion_check import MotionCheck
from gcs_coloc.core.gps_health.receiver_check import ReceiverCheck
from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.messages.inbound import EkfStatus, GpsReceiver, SystemHealth
from gcs_coloc.core.setting_bounds import between, check_bounds, positive


class GpsState(Enum):
    """What the service believes of a vehicle's own GPS."""

    UNKNOWN = "unknown"
    HEALTHY = "healthy"
    SUSPECT = "suspect"
    FAILED = "failed"
    RECOVERING = "recovering"


DISTRUSTED = (GpsState.SUSPECT, GpsState.FAILED, GpsState.RECOVERING)
"""The states in which what a vehicle says of its own position is not believed, and others are to locate it."""


@dataclass(frozen=True, slots=True)
class Contradiction:
    """What the ranges say against a vehicle's GPS position, in words; `identified`: it, and nobody else, is at fault."""

    reason: str
    identified: bool


@dataclass(frozen=True, slots=True)
class GpsHealthSettings:
    """When a vehicle's GPS counts as failed, and as healthy again."""

    fail_after_s: float = positive(1.0)
    """A SUSPECT vehicle without a fix, or with a frozen one, is FAILED after this long; so is one whose receiver is silent
    while SYS_STATUS calls its GPS unhealthy or its EKF has no absolute position. Chosen: longer than one lost message."""
    clear_after_s: float = positive(2.0)
    """Good evidence for this long without a break makes a SUSPECT vehicle HEALTHY. Chosen: a jammed receiver flickers."""
    recover_after_s: float = positive(10.0)
    """Good evidence for this long makes a RECOVERING vehicle HEALTHY. Chosen: long enough for the ranges to contradict it."""
    silence_s: float = positive(3.0)
    """A receiver that is silent for this long is SUSPECT, and its last message counts no more."""
    max_h_acc_m: float = positive(50.0)
    """A fix with a worse stated horizontal accuracy (GPS_RAW_INT.h_acc, 1-sigma) is no fix."""
    min_satellites: int = between(4, 1, 255)
    """A fix from fewer satellites is no fix. Four unknowns (position and clock) need four satellites."""

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(slots=True)
class GpsHealth:
    """The state machine of one vehicle. Fed by `take`, `motion`, `own_fix`, `contradiction`, `word`, `aided`; moved by `update`.

    `own_receiver` is the instance of the receiver that is really its own. `self_fed`: its autopilot may fly on what we send
    though its own receiver is good, so that what it claims is an echo. `return_doubted`: its receiver is back, but contradicted
    at the moment; `return_untested`: there is nothing to hold it against. `duplicate_id` says that two autopilots share
    its system id, so that nothing that is said of one vehicle is said of one.
    """

    settings: GpsHealthSettings
    own_receiver: int = 0
    state: GpsState = GpsState.UNKNOWN
    reason: str = "nothing heard from its GPS receiver yet"
    since_s: float = 0.0
    word: GpsOverride = GpsOverride.AUTO
    aided: bool = False
    self_fed: bool = False
    motion: MotionCheck = field(default_factory=MotionCheck)
    own_fix: ReceiverCheck = field(default_factory=ReceiverCheck)
    contradiction: Contradiction | None = None
    return_doubted: bool = False
    return_untested: bool = False
    duplicate_id: str | None = None
    _good_since_s: float | None = field(default=None)
    _receiver: GpsReceiver | None = field(default=None)
    _system: SystemHealth | None = field(default=None)
    _ekf: EkfStatus | None = field(default=None)

    @property
    def trusted(self) -> bool:
        """Whether what the vehicle says of its own position is evidence."""
        return self.state is GpsState.HEALTHY and not self.self_fed

    def take(self, message: GpsReceiver | SystemHealth | EkfStatus) -> None:
        """Note one piece of evidence. Reports of a receiver other than its own are ignored."""
        if isinstance(message, GpsReceiver):
            if message.receiver == self.own_receiver:
                self._receiver = message
                self.motion.take_receiver(message)
        elif isinstance(message, SystemHealth):
            self._system = message
        else:
            self._ekf = message

    def update(self, now_s: float) -> bool:
        """Move the machine on to `now_s`; True where the state changed."""
        if self.word is not GpsOverride.AUTO:
            forced = GpsState.FAILED if self.word is GpsOverride.FAILED else GpsState.HEALTHY
            return self._enter(forced, f"declared {self.word.value} by the operator", now_s)
        fault = self._fault(now_s)
        receiver = self._receiver
        if receiver is None and fault is None:
            return self._enter(GpsState.UNKNOWN, "nothing heard from its GPS receiver yet", now_s)
        if fault is not None:
            self._good_since_s = None
            return self._bad(fault, now_s)
        if self._good_since_s is None:
            self._good_since_s = now_s
        return self._good(now_s - self._good_since_s, now_s)

    def _bad(self, fault: str, now_s: float) -> bool:
        if self.state is GpsState.FAILED:
            self.reason = fault
            return False
        if self.state is GpsState.RECOVERING:
            return self._enter(GpsState.FAILED, fault, now_s)
        # An accusation has stood the test of several seconds before it is made.
        if self.contradiction is not None and self.contradiction.identified:
            return self._enter(GpsState.FAILED, fault, now_s)
        lost_fix = self._receiver is not None and (self._receiver_fault(self._receiver) is not None or self._has_ceased(now_s))
        if self.state is GpsState.SUSPECT and lost_fix and now_s - self.since_s >= self.settings.fail_after_s:
            return self._enter(GpsState.FAILED, fault, now_s)
        return self._enter(GpsState.SUSPECT, fault, now_s)

    def _good(self, good_for_s: float, now_s: float) -> bool:
        receiver = self._receiver
        assert receiver is not None
        fix = f"fix type {receiver.fix_type}" + (f", {receiver.satellites} satellites" if receiver.satellites is not None else "")
        if self.state in (GpsState.FAILED, GpsState.RECOVERING):
            untested = "; nothing to hold it against" if self.return_untested else ""
            if self.state is GpsState.FAILED or good_for_s < self.settings.recover_after_s or self.return_doubted:
                back = f"{fix}: back, watched for {self.settings.recover_after_s:g} s"
                return self._enter(GpsState.RECOVERING, back + untested, now_s)
            return self._enter(GpsState.HEALTHY, fix + untested, now_s)
        if self.state is GpsState.SUSPECT and good_for_s < self.settings.clear_after_s:
            return False
        return self._enter(GpsState.HEALTHY, fix, now_s)

    def _fault(self, now_s: float) -> str | None:
        """The worst thing that the evidence says, or None."""
        if self.duplicate_id is not None:
            return self.duplicate_id
        receiver = self._receiver
        if receiver is not None:
            fault = self._receiver_fault(receiver)
            if fault is not None:
                return fault
            if now_s - receiver.received_at_s > self.settings.silence_s:
                return f"no GPS_RAW_INT for more than {self.settings.silence_s:g} s"
        if self.contradiction is not None:
            return self.contradiction.reason
        if self.aided:
            return None
        implausible = self.motion.implausible(now_s)
        if implausible is not None:
            return implausible
        if self.own_fix.contradiction is not None:
            return self.own_fix.contradiction
        if self._system is not None and self._system.gps_enabled and not self._system.gps_healthy:
            return "SYS_STATUS: GPS not healthy"
        if self._ekf is not None:
            if self._ekf.gps_glitching:
                return "the autopilot's EKF reports a GPS glitch"
            if self._ekf.constant_position_mode or not self._ekf.horizontal_position_absolute:
                return "the autopilot's EKF has no absolute position"
        return None

    def _has_ceased(self, now_s: float) -> bool:
        """Whether a receiver that is not heard any more is gone, and not just its messages: by what else the vehicle says now."""
        oldest_s = now_s - self.settings.silence_s
        if self._receiver is None or self._receiver.received_at_s >= oldest_s:
            return False
        system, ekf = self._system, self._ekf
        unhealthy = system is not None and system.received_at_s >= oldest_s and system.gps_enabled and not system.gps_healthy
        return unhealthy or (ekf is not None and ekf.received_at_s >= oldest_s and not ekf.horizontal_position_absolute)

    def _receiver_fault(self, receiver: GpsReceiver) -> str | None:
        if receiver.fix_type < 3:
            return f"no 3D fix: fix type {receiver.fix_type}"
        if receiver.satellites is not None and receiver.satellites < self.settings.min_satellites:
            return f"only {receiver.satellites} satellites"
        if receiver.h_acc_m is not None and receiver.h_acc_m > self.settings.max_h_acc_m:
            return f"horizontal accuracy {receiver.h_acc_m:.0f} m is worse than {self.settings.max_h_acc_m:g} m"
        return self.motion.frozen()

    def _enter(self, state: GpsState, reason: str, now_s: float) -> bool:
        changed = state is not self.state
        if changed:
            self.state, self.since_s = state, now_s
        self.reason = reason
        return changed
