"""GPS_PRIMARY of a vehicle whose own receiver is there and lies: set to the receiver that we feed, confirmed, and restored.

ArduPilot goes back to a jammed or spoofed receiver as long as that claims a fix and is the primary one. The value from before
is read first and written back afterwards; every step is confirmed by PARAM_VALUE, tried a few times, and told.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gcs_coloc.core.aiding.parameters import RETRY_S
from gcs_coloc.core.messages.inbound import ParameterValue
from gcs_coloc.core.messages.outbound import Notice, ParameterRequest, ParameterSet

NAME = "GPS_PRIMARY"
_TRIES = 5
_TRY_AGAIN_S = 30.0

Outputs = list[ParameterRequest | ParameterSet | Notice]


class _Step(Enum):
    READING = "being read"
    SETTING = "being set"
    OURS = "ours"
    RESTORING = "being restored"
    LEFT = "left as it is"


@dataclass(slots=True)
class _Switch:
    step: _Step
    due_s: float
    before: ParameterValue | None = None
    tries: int = 0


class PrimarySwitch:
    """The switches of one fleet. `review` each vehicle several times a second, `heard` takes what vehicles tell."""

    def __init__(self, gps_id: int) -> None:
        self._ours = float(gps_id)
        self._switches: dict[int, _Switch] = {}

    def holds(self, sysid: int) -> bool:
        """Whether the vehicle's GPS_PRIMARY is ours by our doing, or may be: what it says of itself is then an echo."""
        switch = self._switches.get(sysid)
        return switch is not None and switch.before is not None

    def switching(self, sysid: int) -> bool:
        """Whether a switch has been begun and not yet been given up or undone."""
        return sysid in self._switches

    def status(self, sysid: int) -> str | None:
        """How it stands with the vehicle's GPS_PRIMARY, in words; None where nothing was done."""
        switch = self._switches.get(sysid)
        return switch.step.value if switch is not None else None

    def review(self, sysid: int, now_s: float, *, wanted: bool) -> Outputs:
        """Take the next step, if one is due, towards what is wanted: our receiver as the primary one, or what it was before."""
        switch = self._switches.get(sysid)
        if switch is None:
            if not wanted:
                return []
            switch = self._switches[sysid] = _Switch(_Step.READING, now_s)
        elif not wanted and switch.step is not _Step.RESTORING:
            if switch.before is None:
                del self._switches[sysid]
                return []
            switch.step, switch.due_s, switch.tries = _Step.RESTORING, now_s, 0
        if switch.step in (_Step.OURS, _Step.LEFT) or now_s < switch.due_s:
            return []
        if switch.tries >= _TRIES:
            return self._give_up(sysid, switch, now_s)
        switch.tries += 1
        switch.due_s = now_s + RETRY_S
        return [self._message(sysid, switch)]

    def add_parameter(self, message: ParameterValue) -> Outputs:
        """Add what a vehicle reports of one of its parameters."""
        switch = self._switches.get(message.sysid)
        if switch is None or message.name != NAME:
            return []
        is_ours = message.value == self._ours
        if switch.step is _Step.READING:
            if is_ours:
                switch.step = _Step.LEFT
                return [_notice(message, "info", f"{NAME} is {message.value:g} already: left as it is")]
            switch.step, switch.before, switch.due_s, switch.tries = _Step.SETTING, message, message.received_at_s, 0
        elif switch.step is _Step.SETTING and is_ours:
            switch.step = _Step.OURS
            assert switch.before is not None
            return [_notice(message, "warning", f"{NAME} set to {self._ours:g}, our receiver; it was {switch.before.value:g}")]
        elif switch.step is _Step.OURS and not is_ours:
            # Somebody else wants it so: to fight over a parameter in flight would be worse than either value.
            switch.step, switch.before = _Step.LEFT, None
            return [_notice(message, "warning", f"{NAME} was set to {message.value:g} by somebody else: left as it is")]
        elif switch.step is _Step.RESTORING and switch.before is not None and message.value == switch.before.value:
            del self._switches[message.sysid]
            return [_notice(message, "info", f"{NAME} restored to {message.value:g}")]
        return []

    def close(self) -> list[ParameterSet]:
        """What restores every vehicle before the service ends; no time is left to see it confirmed."""
        held = [(sysid, switch.before) for sysid, switch in self._switches.items() if switch.before is not None]
        self._switches.clear()
        return [ParameterSet(sysid, NAME, before.value, before.kind) for sysid, before in held]

    def _message(self, sysid: int, switch: _Switch) -> ParameterRequest | ParameterSet:
        if switch.before is None:
            return ParameterRequest(sysid, NAME)
        value = self._ours if switch.step is _Step.SETTING else switch.before.value
        return ParameterSet(sysid, NAME, value, switch.before.kind)

    def _give_up(self, sysid: int, switch: _Switch, now_s: float) -> Outputs:
        switch.tries, switch.due_s = 0, now_s + _TRY_AGAIN_S
        what = {
            _Step.READING: f"{NAME} could not be read",
            _Step.SETTING: f"{NAME} could not be set to {self._ours:g}",
        }.get(switch.step)
        if what is None:
            assert switch.before is not None
            what = f"{NAME} could not be restored to {switch.before.value:g}, which can be done by hand"
        return [Notice(now_s, sysid, "error", f"{what}: no answer; tried again in {_TRY_AGAIN_S:g} s")]


def _notice(message: ParameterValue, level: str, text: str) -> Notice:
    return Notice(message.received_at_s, message.sysid, level, text)
