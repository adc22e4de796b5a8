"""The receiver switch: a vehicle leaves its own faulty receiver and flies on our position.

An autopilot goes back to a jammed or spoofed receiver as long as that reports a fix. ArduPilot does so while it is the primary
one. PX4 fuses it beside ours. Each step of the switch is tried a few times, confirmed by the vehicle, and told to the operator.
In the end everything is restored as it was before.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gcs_coloc.core.aiding.parameters import RETRY_S
from gcs_coloc.core.messages.control import SwitchedReceiver
from gcs_coloc.core.messages.inbound import Autopilot, CommandOutcome, CommandResult, ParameterValue, VehicleCommand
from gcs_coloc.core.messages.outbound import Notice, ParameterRequest, ParameterSet, SensorEnable

GPS_PRIMARY = "GPS_PRIMARY"
_TRIES = 5  # chosen: more than of reading a parameter, as a flight may hang on it
_TRY_AGAIN_S = 30.0  # chosen: an operator is not told more often


class SwitchStep(Enum):
    """How far a switch is, in words."""

    READING = "being read"
    SETTING = "being set"
    OURS = "ours"
    RESTORING = "being restored"
    LEFT = "left as it is"


class ReceiverAnswer(Enum):
    """What a vehicle's answer says of its own receiver."""

    IN_USE = 1
    OUT_OF_USE = 2
    REFUSED = 3
    """It does not let the receiver be switched."""


_DONE = None
_NEXT: dict[tuple[SwitchStep, ReceiverAnswer], tuple[SwitchStep | None, str | None]] = {
    (SwitchStep.READING, ReceiverAnswer.IN_USE): (SwitchStep.SETTING, None),
    (SwitchStep.READING, ReceiverAnswer.OUT_OF_USE): (SwitchStep.LEFT, "info"),
    (SwitchStep.SETTING, ReceiverAnswer.OUT_OF_USE): (SwitchStep.OURS, "warning"),
    (SwitchStep.SETTING, ReceiverAnswer.REFUSED): (SwitchStep.LEFT, "warning"),
    # Somebody else wants it so: to fight over it in flight would be worse than either.
    (SwitchStep.OURS, ReceiverAnswer.IN_USE): (SwitchStep.LEFT, "warning"),
    (SwitchStep.RESTORING, ReceiverAnswer.IN_USE): (_DONE, "info"),
}
"""The next step for an answer, and the level at which it is told, None where it is not; another answer changes nothing."""

Order = ParameterRequest | ParameterSet | SensorEnable


class PrimaryParameter:
    """The own receiver of an ArduPilot, switched by the parameter GPS_PRIMARY.

    GPS_PRIMARY is set to the receiver that we feed, and restored to the value that was read before.

    As `EstimatorSensor` does, it has the orders that take the receiver out of use and back, what answers mean, None where they
    are about something else, and what is told of an answer in a step: of one that changes nothing, or of none (None), that is
    after all tries.
    """

    first_step = SwitchStep.READING

    def __init__(self, sysid: int, gps_id: int, before: ParameterValue | None = None) -> None:
        self._sysid = sysid
        self._ours = float(gps_id)
        self._before = before
        self._told = 0.0

    def before(self) -> SwitchedReceiver:
        """Return the value from before, None until it has been read."""
        before = self._before
        return SwitchedReceiver(self._sysid, before.value, before.kind) if before is not None else SwitchedReceiver(self._sysid)

    def order(self, step: SwitchStep) -> ParameterRequest | ParameterSet:
        """Return the question for its value, or the value that is to be set."""
        if self._before is None:
            return ParameterRequest(self._sysid, GPS_PRIMARY)
        return ParameterSet(
            self._sysid, GPS_PRIMARY, self._ours if step is SwitchStep.SETTING else self._before.value, self._before.kind
        )

    def answer(self, step: SwitchStep, message: ParameterValue | CommandResult) -> ReceiverAnswer | None:
        """Return whether its value is our receiver; when restored, only the value from before counts."""
        if not isinstance(message, ParameterValue) or message.name != GPS_PRIMARY:
            return None
        self._told = message.value
        if message.value == self._ours:
            return ReceiverAnswer.OUT_OF_USE
        if step is SwitchStep.READING:
            self._before = message
        is_restored = self._before is not None and message.value == self._before.value
        return ReceiverAnswer.IN_USE if is_restored or step is not SwitchStep.RESTORING else None

    def wording(self, step: SwitchStep, answer: ReceiverAnswer | None) -> str:
        """Return what is told, with the parameter's values."""
        before, ours = self._before.value if self._before is not None else 0.0, self._ours
        not_restored = f"{GPS_PRIMARY} could not be restored to {before:g}, which can be done by hand"
        return {
            (SwitchStep.READING, None): f"{GPS_PRIMARY} could not be read: no answer",
            (SwitchStep.READING, ReceiverAnswer.OUT_OF_USE): f"{GPS_PRIMARY} is {self._told:g} already: left as it is",
            (SwitchStep.SETTING, None): f"{GPS_PRIMARY} could not be set to {ours:g}: no answer",
            (SwitchStep.SETTING, ReceiverAnswer.IN_USE): f"{GPS_PRIMARY} could not be set to {ours:g}: it stays {self._told:g}",
            (SwitchStep.SETTING, ReceiverAnswer.OUT_OF_USE): f"{GPS_PRIMARY} set to {ours:g}, our receiver; it was {before:g}",
            (SwitchStep.OURS, ReceiverAnswer.IN_USE): f"{GPS_PRIMARY} was set to {self._told:g} by somebody else: left as it is",
            (SwitchStep.RESTORING, None): f"{not_restored}: no answer",
            (SwitchStep.RESTORING, ReceiverAnswer.OUT_OF_USE): f"{not_restored}: it stays {self._told:g}",
            (SwitchStep.RESTORING, ReceiverAnswer.IN_USE): f"{GPS_PRIMARY} restored to {self._told:g}",
        }[step, answer]


class EstimatorSensor:
    """The own receiver of a PX4, switched in EKF2 by a command that not every firmware knows."""

    first_step = SwitchStep.SETTING

    def __init__(self, sysid: int) -> None:
        self._sysid = sysid
        self._outcome = CommandOutcome.OTHER

    def before(self) -> SwitchedReceiver:
        """Return the vehicle: a command restores it."""
        return SwitchedReceiver(self._sysid)

    def order(self, step: SwitchStep) -> SensorEnable:
        """Return the command."""
        return SensorEnable(self._sysid, gps=step is SwitchStep.RESTORING)

    def answer(self, step: SwitchStep, message: ParameterValue | CommandResult) -> ReceiverAnswer | None:
        """Return what the result of the last command says."""
        if not isinstance(message, CommandResult) or message.command is not VehicleCommand.ESTIMATOR_SENSOR_ENABLE:
            return None
        self._outcome = message.outcome
        if message.outcome is CommandOutcome.ACCEPTED:
            return ReceiverAnswer.IN_USE if step is SwitchStep.RESTORING else ReceiverAnswer.OUT_OF_USE
        return ReceiverAnswer.REFUSED if message.outcome is not CommandOutcome.IN_PROGRESS else None

    def wording(self, step: SwitchStep, answer: ReceiverAnswer | None) -> str:
        """Return what is told, with the vehicle's own answer."""
        switched_off = "its own GPS is switched off: it flies on the position that it is sent"
        refused = f"it does not let its own GPS be switched off ({self._outcome.value}): it may follow a faulty receiver"
        return {
            (SwitchStep.SETTING, None): "its GPS could not be switched off: no answer",
            (SwitchStep.SETTING, ReceiverAnswer.OUT_OF_USE): switched_off,
            (SwitchStep.SETTING, ReceiverAnswer.REFUSED): refused,
            (SwitchStep.RESTORING, None): "its GPS could not be switched on: no answer",
            (SwitchStep.RESTORING, ReceiverAnswer.REFUSED): f"it does not let its own GPS be switched on ({self._outcome.value})",
            (SwitchStep.RESTORING, ReceiverAnswer.IN_USE): "its own GPS is switched on again",
        }[step, answer]


OwnReceiver = PrimaryParameter | EstimatorSensor
"""One vehicle's own receiver."""


@dataclass(slots=True)
class _Switch:
    """One switch. `answer` is the last one in its step that changed nothing."""

    receiver: OwnReceiver
    step: SwitchStep
    due_s: float
    tries: int = 0
    answer: ReceiverAnswer | None = None

    @property
    def is_held(self) -> bool:
        """Whether its own receiver is out of use by our doing, or may be."""
        return self.step in (SwitchStep.SETTING, SwitchStep.OURS, SwitchStep.RESTORING)

    def begin_step(self, step: SwitchStep, due_s: float) -> None:
        """Begin a step, or its tries anew."""
        self.step, self.due_s, self.tries, self.answer = step, due_s, 0, None


class ReceiverSwitch:
    """The receiver switches of one fleet.

    Call `review` for each vehicle several times a second, and `add_answer` for what vehicles answer.
    """

    def __init__(self, gps_id: int) -> None:
        self._gps_id = gps_id
        self._switches: dict[int, _Switch] = {}

    def holds(self, sysid: int) -> bool:
        """Return whether a vehicle may fly on our fix alone by our doing, so that its reports are an echo."""
        switch = self._switches.get(sysid)
        return switch is not None and switch.is_held

    def switching(self, sysid: int) -> bool:
        """Return whether a switch was begun and neither given up nor undone."""
        return sysid in self._switches

    def held(self) -> tuple[SwitchedReceiver, ...]:
        """Return the receivers that are out of use by our doing, or may be."""
        return tuple(switch.receiver.before() for switch in self._switches.values() if switch.is_held)

    def adopt(self, receiver: SwitchedReceiver, now_s: float, *, held: bool) -> None:
        """Take over a switch of the other service, to keep or to restore it; forget it where it is not `held`."""
        sysid = receiver.sysid
        if not held:
            self.forget(sysid)
            return
        own: OwnReceiver = EstimatorSensor(sysid)
        if receiver.before is not None and receiver.kind is not None:
            before = ParameterValue(sysid, now_s, GPS_PRIMARY, receiver.before, receiver.kind)
            own = PrimaryParameter(sysid, self._gps_id, before)
        self._switches[sysid] = _Switch(own, SwitchStep.OURS, now_s)

    def forget(self, sysid: int) -> None:
        """Forget the switch of a vehicle, without restoring anything."""
        self._switches.pop(sysid, None)

    def status(self, sysid: int) -> str | None:
        """Return the state of the switch in words; None where nothing was done."""
        switch = self._switches.get(sysid)
        return switch.step.value if switch is not None else None

    def review(self, sysid: int, autopilot: Autopilot | None, now_s: float, *, wanted: bool) -> list[Order | Notice]:
        """Return the order or notice that is due; `wanted`: its own receiver is to be out of use."""
        switch = self._switches.get(sysid)
        if switch is None:
            if not wanted:
                return []
            is_px4 = autopilot is Autopilot.PX4
            receiver: OwnReceiver = EstimatorSensor(sysid) if is_px4 else PrimaryParameter(sysid, self._gps_id)
            switch = self._switches[sysid] = _Switch(receiver, receiver.first_step, now_s)
        elif not wanted and switch.step is not SwitchStep.RESTORING:
            if not switch.is_held:
                del self._switches[sysid]
                return []
            switch.begin_step(SwitchStep.RESTORING, now_s)
        if switch.step in (SwitchStep.OURS, SwitchStep.LEFT) or now_s < switch.due_s:
            return []
        if switch.tries >= _TRIES:
            text = f"{switch.receiver.wording(switch.step, switch.answer)}; tried again in {_TRY_AGAIN_S:g} s"
            switch.begin_step(switch.step, now_s + _TRY_AGAIN_S)
            return [Notice(now_s, sysid, "error", text)]
        switch.tries, switch.due_s = switch.tries + 1, now_s + RETRY_S
        return [switch.receiver.order(switch.step)]

    def add_answer(self, message: ParameterValue | CommandResult) -> list[Notice]:
        """Add what a vehicle reports of a parameter, or made of a command."""
        switch = self._switches.get(message.sysid)
        answer = switch.receiver.answer(switch.step, message) if switch is not None else None
        if switch is None or answer is None:
            return []
        if (switch.step, answer) not in _NEXT:
            switch.answer = answer
            return []
        step, (following, level) = switch.step, _NEXT[switch.step, answer]
        if following is _DONE:
            del self._switches[message.sysid]
        else:
            switch.begin_step(following, message.received_at_s)
        if level is None:
            return []
        return [Notice(message.received_at_s, message.sysid, level, switch.receiver.wording(step, answer))]

    def close(self) -> list[Order]:
        """Return what restores every vehicle before the service ends; no time is left to see it confirmed."""
        held = [switch for switch in self._switches.values() if switch.is_held]
        self._switches.clear()
        return [switch.receiver.order(SwitchStep.RESTORING) for switch in held]
