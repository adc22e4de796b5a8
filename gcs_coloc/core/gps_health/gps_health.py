"""GPS health of one vehicle: a small state machine that always has a reason.

    UNKNOWN -> HEALTHY -> SUSPECT -> FAILED -> RECOVERING -> HEALTHY
                  ^---------/           ^---------/

Evidence is what the vehicle's real receiver says in GPS_RAW_INT (in GPS2_RAW where we feed the first one), the GPS bit of
SYS_STATUS and the EKF's flags, and in GNSS_INTEGRITY where it sends that: spoofing, jamming that it does not master, a failed
RAIM. SYS_STATUS and the EKF speak of the receiver *in use*: while the vehicle is aided they are an echo of our
fix and count for nothing, as does a glitch that the EKF still reports some seconds later. The receiver that we feed never
counts. What the service itself finds counts as well: a receiver that repeats one position on the move (`MotionCheck`) is as
good as lost, and so is one that the ranges identify as faulty (`integrity`); a position other than the receiver's
(`ReceiverCheck`) is suspect. The operator's override wins over everything.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gcs_coloc.core.gps_health.evidence import GpsEvidence, GpsReason, is_fresh, reported_interference
from gcs_coloc.core.gps_health.position_checks import DopplerCheck, MotionCheck, ReceiverCheck
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.control import HOST_LATE_S, GpsOverride
from gcs_coloc.core.messages.inbound import FIX_3D, GlobalPosition, GpsReceiver, Interference
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.setting_bounds import between, check_bounds, positive


class GpsState(Enum):
    """What the service believes of a vehicle's own GPS."""

    UNKNOWN = "unknown"
    HEALTHY = "healthy"
    SUSPECT = "suspect"
    FAILED = "failed"
    RECOVERING = "recovering"


DISTRUSTED = (GpsState.SUSPECT, GpsState.FAILED, GpsState.RECOVERING)
"""The states in which a vehicle's reported position is not believed, so that it is located from ranges."""


@dataclass(frozen=True, slots=True)
class GpsHealthSettings:
    """When a vehicle's GPS counts as failed, and as healthy again."""

    fail_after_s: float = positive(1.0)
    """A SUSPECT vehicle without a fix, or with a frozen one, is FAILED after this long, one that never had a fix at once; so is
    one that is heard without its receiver since SYS_STATUS calls its GPS unhealthy or its EKF has no absolute position. Chosen:
    longer than one lost message."""
    clear_after_s: float = positive(2.0)
    """Good evidence for this long without a break makes a SUSPECT vehicle HEALTHY. Chosen: a jammed receiver flickers."""
    steady_after_s: float = positive(3.0)
    """A FAILED vehicle is RECOVERING after good evidence for this long without a break; twice as long after each relapse, 30 s at
    most. Chosen: a jammed receiver has fixes for fractions of a second."""
    recover_after_s: float = positive(10.0)
    """Good evidence for this long makes a FAILED or RECOVERING vehicle HEALTHY. Chosen: the ranges have time to contradict it."""
    silence_s: float = positive(3.0)
    """A receiver that is silent for this long is SUSPECT, and its last message counts no more; for three times as long where
    its autopilot has said since that the GPS works, as poor radios lose more than that in a row."""
    max_h_acc_m: float = positive(50.0)
    """A fix with a worse stated horizontal accuracy (GPS_RAW_INT.h_acc, 1-sigma) is no fix."""
    min_satellites: int = between(4, 1, 255)
    """A fix from fewer satellites is no fix. Four unknowns (position and clock) need four satellites."""

    def __post_init__(self) -> None:
        check_bounds(self)


_LONGEST_STEADY_S = 30.0  # chosen: a fix that comes for seconds under jamming has gone again by then
_MOST_DOUBLINGS = 1023  # of a float: one more raises OverflowError
_RELAPSE_WITHIN_S = 60.0  # chosen: a loss later than this after the recovery is another one
_CEASED_S, _CEASED_UNUSED_S = 2.0, 10.0
"""A receiver is gone where its autopilot was heard for so long without it: one that the autopilot complains of since then, and
one that it did not use before, as before a take-off. Chosen: telemetry radios lose four reports in a row, but not ten."""
_GAP_TIMES = 3.0  # the silence; source: of 130 gaps beyond 3 s in 3.7 h of recordings from real radios 104 were within 9 s
_HEARD_STEP_S = 1.0  # of a gap between two messages; source: usual rates of SYS_STATUS and EKF_STATUS_REPORT are 1 Hz and more
_EKF_LINGERS_S = 12.0  # EKF3 holds the worst speed accuracy with a decay of 10 s, and wants 10 s of good innovations

_NOTHING_AGAINST_IT = (GpsReason.CONTRADICTED_BY_RANGES, GpsReason.SILENT)

_NOTHING_HEARD = StatedReason(GpsReason.NOTHING_HEARD)


class GpsHealth:
    """The GPS health of one vehicle: a state machine that `update` moves by evidence and checks.

    `state` is that since the last update, `reason` what speaks for it.
    """

    def __init__(self, settings: GpsHealthSettings) -> None:
        self._settings = settings
        self.state = GpsState.UNKNOWN
        self.reason = _NOTHING_HEARD
        self._since_s = 0.0
        self._good_since_s: float | None = None
        self._relapses = 0
        self._flickered = False
        self._has_bad_fix = False
        self._was_healthy = self._was_failed = False
        self._was_silent_only = False
        self._has_own_trouble = False
        self._is_placed = True
        self._aided_at_s = float("-inf")
        self._complains_since_s, self._complained_at_s = float("inf"), float("-inf")
        self._reported_at_s = self._heard_at_s = float("-inf")
        self._heard_without_s = 0.0
        self._motion = MotionCheck()
        self._own_fix = ReceiverCheck()
        self._doppler = DopplerCheck()

    @property
    def is_returning(self) -> bool:
        """Whether a failed vehicle has good evidence again: RECOVERING, or FAILED and not good for long yet."""
        return self.state is GpsState.RECOVERING or (self.state is GpsState.FAILED and self._good_since_s is not None)

    @property
    def reports_false_fix(self) -> bool:
        """Whether the receiver of a FAILED vehicle reports a fix all the same, or one that came and went."""
        return self.state is GpsState.FAILED and (self._has_bad_fix or self._flickered)

    @property
    def may_witness(self) -> bool:
        """Whether nothing speaks against it but ranges that leave open who is at fault, or a past silence."""
        is_open = self.state is GpsState.SUSPECT and self.reason.reason in _NOTHING_AGAINST_IT
        return (self.state is GpsState.HEALTHY or is_open) and not self._has_own_trouble

    def is_doubtful(self, now_s: float) -> bool:
        """Return whether the receiver's fixes have moved otherwise than its own velocity says.

        That is evidence where ranges leave open who is at fault.
        """
        return self._doppler.drifts(now_s)

    def add_receiver(self, fix: GpsReceiver, position: GlobalPosition | None) -> None:
        """Add a report of the vehicle's own receiver, with the position that its autopilot reported last."""
        self._own_fix.add(fix, position)
        self._motion.add_receiver(fix)
        self._doppler.add(fix)

    def add_position(self, reported: PositionMeasurement, *, own: bool) -> None:
        """Add the position that its autopilot reports. `own` is False while the vehicle is aided."""
        self._motion.add_position(reported, own=own, is_placed=self._is_placed)

    def update(self, evidence: GpsEvidence, now_s: float) -> bool:
        """Move the machine on to `now_s`; True where the state changed."""
        if evidence.is_aided:
            self._aided_at_s = now_s
        self._listen(evidence)
        receiver, fault = evidence.receiver, self._fault(evidence, now_s)
        is_fresh = receiver is not None and now_s - receiver.received_at_s <= self._settings.silence_s
        has_fix = is_fresh and receiver is not None and receiver.fix_type >= FIX_3D
        self._has_bad_fix = has_fix and (fault is not None or evidence.override is GpsOverride.FAILED)
        if evidence.override is not GpsOverride.AUTO:
            forced = GpsState.FAILED if evidence.override is GpsOverride.FAILED else GpsState.HEALTHY
            self._has_own_trouble = False
            return self._enter(forced, StatedReason(GpsReason.OVERRIDDEN, detail=evidence.override.value), now_s)
        if fault is not None:
            is_silent = fault.reason is GpsReason.SILENT
            was_good = self._good_since_s is not None and self.state is not GpsState.HEALTHY
            self._flickered = self._flickered or (was_good and not is_silent)
            self._was_silent_only = is_silent and (self.state is GpsState.HEALTHY or self._was_silent_only)
            self._good_since_s = None
            return self._bad(fault, evidence, now_s)
        if evidence.receiver is None:
            return self._enter(GpsState.UNKNOWN, _NOTHING_HEARD, now_s)
        if self._good_since_s is None:
            self._good_since_s = now_s
        return self._good(evidence.receiver, evidence, now_s - self._good_since_s, now_s)

    def _bad(self, fault: StatedReason[GpsReason], evidence: GpsEvidence, now_s: float) -> bool:
        if self.state is GpsState.FAILED:
            self.reason = fault
            return False
        if self.state is GpsState.RECOVERING:
            if fault.reason is GpsReason.SILENT and not self._is_silent(evidence, _GAP_TIMES, now_s):
                self.reason = fault
                return False
            self._relapses += 1
            return self._enter(GpsState.FAILED, fault, now_s)
        # An identified fault has stood the test of several seconds before it is stated.
        if evidence.contradiction is not None and evidence.contradiction.is_identified:
            return self._enter(GpsState.FAILED, fault, now_s)
        receiver = evidence.receiver
        lost_fix = receiver is not None and (self._receiver_fault(receiver) is not None or self._has_ceased(now_s))
        # A vehicle without a fix from the first message on, as after a restart in a loss, has no lost message to wait out.
        is_lasting = self.state is GpsState.SUSPECT and now_s - self._since_s >= self._settings.fail_after_s
        if lost_fix and (is_lasting or not self._was_healthy):
            return self._enter(GpsState.FAILED, fault, now_s)
        return self._enter(GpsState.SUSPECT, fault, now_s)

    def _good(self, receiver: GpsReceiver, evidence: GpsEvidence, good_for_s: float, now_s: float) -> bool:
        fix = f"fix type {receiver.fix_type}" + (f", {receiver.satellites} satellites" if receiver.satellites is not None else "")
        if is_fresh(evidence.integrity, now_s) and evidence.integrity.jamming is Interference.MITIGATED:
            fix += ", jamming mitigated"
        untested = evidence.is_return_untested
        if self.state in (GpsState.FAILED, GpsState.RECOVERING):
            steady_s = min(self._settings.steady_after_s * 2.0 ** min(self._relapses, _MOST_DOUBLINGS), _LONGEST_STEADY_S)
            if good_for_s < steady_s:
                self.reason = StatedReason(GpsReason.RETURNING, limit=steady_s, detail=fix)
                return False
            recover_after_s = max(self._settings.recover_after_s, steady_s)
            if self.state is GpsState.FAILED or good_for_s < recover_after_s or evidence.is_return_contradicted:
                reason = GpsReason.RETURNED_UNTESTED if untested else GpsReason.RETURNED
                return self._enter(GpsState.RECOVERING, StatedReason(reason, limit=recover_after_s, detail=fix), now_s)
            reason = GpsReason.RECOVERED_UNTESTED if untested else GpsReason.FIX
            self._flickered = False
            return self._enter(GpsState.HEALTHY, StatedReason(reason, detail=fix), now_s)
        if self.state is GpsState.SUSPECT and good_for_s < self._settings.clear_after_s and not self._was_silent_only:
            return False
        if self.state is GpsState.SUSPECT and evidence.is_return_contradicted:
            self.reason = StatedReason(GpsReason.RETURN_CONTRADICTED, detail=fix)
            return False
        return self._enter(GpsState.HEALTHY, StatedReason(GpsReason.FIX, detail=fix), now_s)

    def _fault(self, evidence: GpsEvidence, now_s: float) -> StatedReason[GpsReason] | None:
        """Return the worst thing that the evidence says, or None."""
        of_receiver, of_autopilot = self._trouble_of_receiver(evidence, now_s), self._trouble_of_autopilot(evidence, now_s)
        self._has_own_trouble = of_receiver is not None or of_autopilot is not None
        is_excused = evidence.host_lag_s > HOST_LATE_S and self.state is GpsState.HEALTHY
        contradiction = evidence.contradiction
        if of_receiver is None and contradiction is not None and (contradiction.is_identified or not is_excused):
            return StatedReason(GpsReason.CONTRADICTED_BY_RANGES, detail=contradiction.text)
        return of_receiver or of_autopilot

    def _trouble_of_receiver(self, evidence: GpsEvidence, now_s: float) -> StatedReason[GpsReason] | None:
        if evidence.has_duplicate_id:
            return StatedReason(GpsReason.DUPLICATE_ID)
        receiver = evidence.receiver
        if receiver is not None:
            fault = self._receiver_fault(receiver)
            if fault is not None:
                return fault
            reported = reported_interference(evidence.integrity, now_s)
            if reported is not None:
                return StatedReason(reported)
            times = _GAP_TIMES if self._is_vouched_for(evidence, now_s) else 1.0
            if self._is_silent(evidence, times, now_s):
                return StatedReason(GpsReason.SILENT, limit=times * self._settings.silence_s)
        return None

    def _is_silent(self, evidence: GpsEvidence, times: float, now_s: float) -> bool:
        limit_s = times * self._settings.silence_s + evidence.host_lag_s
        return evidence.receiver is not None and now_s - evidence.receiver.received_at_s > limit_s

    def _is_vouched_for(self, evidence: GpsEvidence, now_s: float) -> bool:
        """Return whether its autopilot says, later than the receiver was heard last, that it has its GPS."""
        oldest_s = max(self._reported_at_s, now_s - self._settings.silence_s)
        system, ekf = evidence.system, evidence.ekf
        says_system = system is not None and system.received_at_s > oldest_s and system.gps_enabled and system.gps_healthy
        says_ekf = ekf is not None and ekf.received_at_s > oldest_s and ekf.horizontal_position_absolute
        return not evidence.is_aided and (says_system or says_ekf)

    def _trouble_of_autopilot(self, evidence: GpsEvidence, now_s: float) -> StatedReason[GpsReason] | None:
        if evidence.is_aided:
            return None
        implausible = self._motion.implausible(now_s)
        if implausible is not None:
            return implausible
        if self._own_fix.fault is not None:
            return self._own_fix.fault
        if evidence.system is not None and evidence.system.gps_enabled and not evidence.system.gps_healthy:
            return StatedReason(GpsReason.SYSTEM_UNHEALTHY)
        if evidence.ekf is not None:
            if evidence.ekf.gps_glitching and now_s - self._aided_at_s > _EKF_LINGERS_S:
                return StatedReason(GpsReason.EKF_GLITCH)
            if evidence.ekf.constant_position_mode or not evidence.ekf.horizontal_position_absolute:
                return StatedReason(GpsReason.EKF_NOT_ABSOLUTE)
        return None

    def _listen(self, evidence: GpsEvidence) -> None:
        """Note since when its autopilot complains, and for how long it was heard since its receiver was."""
        system, ekf, receiver = evidence.system, evidence.ekf, evidence.receiver
        newest_s = max((each.received_at_s for each in (system, ekf) if each is not None), default=float("-inf"))
        complaints_s = [system.received_at_s] if system is not None and system.gps_enabled and not system.gps_healthy else []
        self._is_placed = ekf is None or ekf.horizontal_position_absolute
        if ekf is not None and not self._is_placed:
            complaints_s.append(ekf.received_at_s)
        self._complains_since_s = min(self._complains_since_s, *complaints_s) if complaints_s else float("inf")
        self._complained_at_s = max(complaints_s, default=float("-inf"))
        if receiver is not None and receiver.received_at_s > self._reported_at_s:
            self._reported_at_s = self._heard_at_s = receiver.received_at_s
            self._heard_without_s = 0.0
        if newest_s > self._heard_at_s:
            self._heard_without_s += min(newest_s - self._heard_at_s, _HEARD_STEP_S)
            self._heard_at_s = newest_s

    def _has_ceased(self, now_s: float) -> bool:
        """Return whether a receiver that is not heard any more is gone, by what else the vehicle says now."""
        oldest_s = now_s - self._settings.silence_s
        if self._reported_at_s >= oldest_s or self._complained_at_s < oldest_s:
            return False
        began_with_it = self._complains_since_s >= self._reported_at_s - _HEARD_STEP_S
        return self._heard_without_s >= (_CEASED_S if began_with_it else _CEASED_UNUSED_S)

    def _receiver_fault(self, receiver: GpsReceiver) -> StatedReason[GpsReason] | None:
        if receiver.fix_type < FIX_3D:
            return StatedReason(GpsReason.NO_FIX, receiver.fix_type)
        if receiver.satellites is not None and receiver.satellites < self._settings.min_satellites:
            return StatedReason(GpsReason.FEW_SATELLITES, receiver.satellites)
        if receiver.h_acc_m is not None and receiver.h_acc_m > self._settings.max_h_acc_m:
            return StatedReason(GpsReason.POOR_ACCURACY, receiver.h_acc_m, self._settings.max_h_acc_m)
        return self._motion.frozen()

    def _enter(self, state: GpsState, reason: StatedReason[GpsReason], now_s: float) -> bool:
        changed = state is not self.state
        if changed:
            if self.state is GpsState.HEALTHY:
                self._relapses = self._relapses + 1 if self._was_failed and now_s - self._since_s < _RELAPSE_WITHIN_S else 0
            self._was_healthy = self._was_healthy or state is GpsState.HEALTHY
            self._was_failed = self._was_failed or state is GpsState.FAILED
            self.state, self._since_s = state, now_s
        self.reason = reason
        return changed


class FleetGpsHealth(dict[int, GpsHealth]):
    """The state machine of each vehicle of a fleet, UNKNOWN where nothing was heard."""

    def __init__(self, settings: GpsHealthSettings) -> None:
        super().__init__()
        self._settings = settings

    def __missing__(self, sysid: int) -> GpsHealth:
        health = self[sysid] = GpsHealth(self._settings)
        return health

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one."""
        self.pop(sysid, None)

    def reason(self, sysid: int) -> str:
        """Return what speaks for the state of a vehicle, in words."""
        return self[sysid].reason.text
