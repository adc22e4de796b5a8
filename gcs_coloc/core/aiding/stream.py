"""The aiding stream to one vehicle: its schedule, its fix policy and its acknowledgement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import sqrt

from gcs_coloc.core.aiding.fix_policy import FixPolicy
from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason
from gcs_coloc.core.aiding.methods.method import AidingMethod, FixInputs, Moment
from gcs_coloc.core.aiding.methods.registry import METHODS
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.control import PrimaryOverride
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, Outbound
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.schedule import TickSchedule
from gcs_coloc.core.telemetry.altitude_builder import SentFix

_LONGEST_LEAD_S = 0.5  # beyond, a prediction is worth less than the delay costs
_WARNED_AFTER_S = 1.0  # chosen: an estimator counts ranges as in use for a while after the last; a lost one raises nothing
_FIRST_REPORT_S = 1.0  # chosen: five periods of GLOBAL_POSITION_INT at the least useful rate

EstimateAt = Callable[[int, float], Estimate | NoEstimate]


class Purpose(Enum):
    """Why a vehicle has a stream."""

    AID = "aid"
    HAND_BACK = "handing back"
    STANDBY = "standby"


@dataclass(frozen=True, slots=True)
class AidingDecision:
    """What was decided about one vehicle.

    `method`: by which it is aided, None where it has no stream. `purpose`: why it is to have one, None where it is not.
    `inhibit`: why it cannot be aided. `is_aided`: it may fly on our fix. `is_self_fed`: it may do so though its own receiver is
    good, so that what it reports is an echo. `outputs`: what is to be sent and shown.
    """

    method: AidingMethodName | None = None
    purpose: Purpose | None = None
    inhibit: Inhibit | None = None
    is_aided: bool = False
    is_self_fed: bool = False
    outputs: tuple[Outbound, ...] = ()


@dataclass(frozen=True, slots=True)
class AidingView:
    """The aiding of one vehicle as observers see it; the fields are those of `VehicleSnapshot`."""

    status: str
    is_held_back: bool
    has_fix: bool
    fix_acknowledged: bool | None
    gps_primary: str | None
    inhibit_reason: str | None


class AidingStream:
    """The stream to one vehicle, which it has for a `purpose`.

    `inhibit`: why the last message had no fix, None where it had one. `sent_fix`: the last fix. `acknowledgement`: is it used?
    None where no message shows it. `transmits`: what is built is sent; else what the vehicle reports is no answer to it.
    """

    def __init__(
        self,
        sysid: int,
        name: AidingMethodName,
        method: AidingMethod,
        settings: AidingSettings,
        now_s: float,
        purpose: Purpose,
        schedule: TickSchedule,
        *,
        transmits: bool = True,
    ) -> None:
        self.name = name
        self.method = method
        self.due_s = now_s
        self.inhibit: Inhibit | None = StatedReason(InhibitReason.NOT_SENT_YET)
        self.sent_fix: SentFix | None = None
        self._sysid = sysid
        self.purpose = purpose
        self._purpose_since_s = now_s
        self._schedule = schedule
        self._transmits = transmits
        self._settings = settings
        self.acknowledgement = METHODS[name].acknowledgement(settings.gps_id, now_s) if transmits else None
        self._policy = FixPolicy(settings, now_s)
        self._period_s = METHODS[name].period_s or 1.0 / settings.rate_hz
        self._told_has_fix: bool | None = None
        self._is_predicting = False
        self._told_prediction = False

    def set_purpose(self, purpose: Purpose, now_s: float) -> None:
        """Change the purpose."""
        if purpose is not self.purpose:
            if self.purpose is Purpose.STANDBY:
                # On standby the fix was the vehicle's own: that it was lost is no flicker of the aid that begins.
                self._policy = FixPolicy(self._settings, now_s)
            self.purpose, self._purpose_since_s = purpose, now_s

    def restart_purpose(self, now_s: float) -> None:
        """Count the time of the purpose from now on."""
        self._purpose_since_s = now_s

    def purpose_for_s(self, now_s: float) -> float:
        """Return for how long the purpose has been the same, s."""
        return now_s - self._purpose_since_s

    def poll(
        self,
        now_s: float,
        inputs: FixInputs,
        frame: LocalFrame | None,
        utc_minus_service_s: float | None,
        estimate_at: EstimateAt,
        *,
        is_held_back: bool = False,
    ) -> list[Outbound]:
        """Build what is due at `now_s`: the method's messages, and a notice where the fix is gained or lost.

        While what is built `is_held_back` nobody is sent it, so there is no such notice. What holds is told once it is sent.

        Deadlines keep the fleet's schedule, so that all vehicles' are due at once. Those that a late call has missed are left
        out.

        The vehicle takes the data to be `age_s` old when they arrive. So the estimate is for a time that is later by the least
        delay of the link. By how much a message takes longer than that, the vehicle's driver finds from the time in it.
        """
        self.due_s = self._schedule.after(now_s, self._period_s)
        arrives_s = now_s + min(inputs.one_way_delay_s or 0.0, _LONGEST_LEAD_S)
        where = estimate_at(self._sysid, arrives_s - self.method.age_s)
        is_aid = self.purpose is Purpose.AID
        if isinstance(where, NoEstimate) and not is_aid and self.purpose_for_s(now_s) < _FIRST_REPORT_S:
            # Trusted again, it has not reported yet: a message left out does less harm than one without a fix.
            return []
        inhibit = self._policy.inhibit(
            where,
            now_s,
            own_gps=inputs.is_trusted,
            air_data=inputs.has_air_data,
            median_nis=inputs.median_nis,
            range_jump_m=inputs.range_jump_m,
        )
        if inhibit is None and self._transmits and isinstance(where, Estimate):
            self.sent_fix = SentFix(now_s, sqrt(float(where.covariance[2, 2])))
        moment = Moment(
            now_s=now_s,
            arrives_s=arrives_s,
            frame=frame,
            utc_minus_service_s=utc_minus_service_s,
            where=where,
            inhibit=inhibit,
            known=inputs,
            standby=not is_aid,
            transmits=self._transmits,
        )
        out: list[Outbound] = list(self.method.build_messages(moment))
        for message in out:
            if self.acknowledgement is not None and isinstance(message, AidingMessage):
                self.acknowledgement.add_sent(message, now_s)
        self.inhibit = inhibit
        has_run_s = self._settings.prediction_s - self._policy.prediction_left_s(now_s)
        self._is_predicting = inhibit is None and is_aid and has_run_s > _WARNED_AFTER_S
        if is_held_back:
            self._told_has_fix, self._told_prediction = None, False
            return out
        return out + self._tell_of_fix(now_s) + self._tell_of_prediction(now_s)

    def wants_switch(self, override: PrimaryOverride, *, is_switching: bool, is_lost: bool) -> bool:
        """Return whether the vehicle is to fly on our fix alone, without its own receiver.

        That begins only where the vehicle acknowledges our fix, and lasts as long as its aid.

        `is_switching`: that has begun. `is_lost`: its own receiver has failed, so that whatever fix it reports next is not to be
        followed until it is tested. An ArduPilot takes that fix at once, and goes back to its own receiver by itself should our
        stream end. A PX4 would not go back: it leaves out only a receiver that reports a false fix.

        While its own receiver has a fix a PX4 shows nothing of ours, but may have shown before that it does not use it.
        """
        if self.purpose is not Purpose.AID or self.acknowledgement is None or override is PrimaryOverride.OWN:
            return False
        is_automatic = self._settings.switch_primary == "auto"
        if is_switching:
            return override is PrimaryOverride.OURS or is_automatic
        acknowledged = self.acknowledgement.acknowledged
        if self.inhibit is not None or acknowledged is False or (acknowledged is None and METHODS[self.name].feeds_receiver):
            return False
        return override is PrimaryOverride.OURS or (is_automatic and is_lost)

    def status(self) -> str:
        """Return what is sent in a few words, but not why there is no estimate: that stands at the position."""
        lead = "sending" if self.purpose is Purpose.AID else f"{self.purpose.value}: sending"
        if self.inhibit is not None:
            reason = "" if self.inhibit.reason is InhibitReason.NO_ESTIMATE else f": {self.inhibit.text}"
            return f"{lead} {self.method.without_fix()}{reason}"
        fault = self.acknowledgement.fault if self.acknowledgement is not None else None
        predicted = " on prediction, its ranges have ceased" if self._is_predicting else ""
        return f"{lead} {self.method.with_fix()}{predicted}" + (f", NOT TAKEN: {fault}" if fault is not None else "")

    def _tell_of_fix(self, now_s: float) -> list[Outbound]:
        """Return the notice that the fix is gained or lost."""
        has_fix, had_fix = self.inhibit is None, self._told_has_fix
        self._told_has_fix = has_fix
        if has_fix is had_fix:
            return []
        if self.inhibit is None:
            return [Notice(now_s, self._sysid, "info", "located: sending positions")]
        text = f"not located, sending {self.method.without_fix()}: {self.inhibit.text}"
        return [Notice(now_s, self._sysid, "warning", text)]

    def _tell_of_prediction(self, now_s: float) -> list[Outbound]:
        """Return the warning, in time to act (PX4: 5 s), that ranges have ceased, or that they are back."""
        was_told = self._told_prediction
        self._told_prediction = self._is_predicting
        if self._is_predicting and not was_told:
            left_s = self._policy.prediction_left_s(now_s)
            text = f"its ranges have ceased: its position is predicted, and sent for {max(left_s, 0.0):.0f} s more without them"
            return [Notice(now_s, self._sysid, "error", text)]
        if was_told and not self._is_predicting and self.inhibit is None:
            return [Notice(now_s, self._sysid, "info", "its ranges have come back")]
        return []
