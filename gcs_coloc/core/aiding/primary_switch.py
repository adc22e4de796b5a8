"""GPS_PRIMARY of a vehicle whose own receiver is there and lies: set to the receiver that we feed, confirmed, and restored.

ArduPilot goes back to a jammed or spoofed receiver as long as that claims a fix and is the primary one. The value from before
is read first and written back afterwards; every step is confirmed by PARAM_VALUE, tried a few times, and told.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gcs_coloc.core.messages.inbound import ParameterValue
from gcs_coloc.core.messages.outbound import Notice, ParameterRequest, ParameterSet

NAME = "GPS_PRIMARY"
RETRY_S = 1.0
"""Chosen: longer than a slow radio takes for question and answer."""
_READ_TRIES = 3  # chosen: nothing hangs on a value that is read
SET_TRIES = 5
"""Chosen: more than of reading, as a flight may hang on it."""
_FRESH_S = 30.0  # chosen: somebody else may change a parameter in flight; one question in so long costs a radio nothing
TRY_AGAIN_S = 30.0
"""Chosen: an operator is not told more often."""

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
        if switch.tries >= SET_TRIES:
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
        switch.tries, switch.due_s = 0, now_s + TRY_AGAIN_S
        what = {
            _Step.READING: f"{NAME} could not be read",
            _Step.SETTING: f"{NAME} could not be set to {self._ours:g}",
        }.get(switch.step)
        if what is None:
            assert switch.before is not None
            what = f"{NAME} could not be restored to {switch.before.value:g}, which can be done by hand"
        return [Notice(now_s, sysid, "error", f"{what}: no answer; tried again in {TRY_AGAIN_S:g} s")]


def _notice(message: ParameterValue, level: str, text: str) -> Notice:
    return Notice(message.received_at_s, message.sysid, level, text)


@dataclass(slots=True)
class _PendingRequest:
    due_s: float
    tries: int = 0


class Parameters:
    """What the vehicles of one fleet have told of the parameters that somebody wants to know."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, str], ParameterValue] = {}
        self._requested: dict[tuple[int, str], _PendingRequest] = {}
        self._unanswered: set[tuple[int, str]] = set()

    def request(self, sysid: int, name: str, now_s: float) -> None:
        """Request a parameter where it is not known or was told long ago: somebody else may have changed it since."""
        key = (sysid, name)
        known, pending = self._known.get(key), self._requested.get(key)
        if known is not None and now_s - known.received_at_s < _FRESH_S:
            return
        if pending is None or (pending.tries >= _READ_TRIES and now_s >= pending.due_s):
            self._requested[key] = _PendingRequest(now_s)

    def add(self, message: ParameterValue) -> None:
        """Add what a vehicle reports; a parameter that nobody wants is passed over."""
        key = (message.sysid, message.name)
        if key in self._requested:
            self._known[key] = message
            self._unanswered.discard(key)
            self._requested[key].tries, self._requested[key].due_s = _READ_TRIES, message.received_at_s + _FRESH_S

    def forget(self, sysid: int) -> None:
        """The vehicle was rebooted: what it told before may hold no more."""
        self._known = {key: value for key, value in self._known.items() if key[0] != sysid}
        self._requested = {key: pending for key, pending in self._requested.items() if key[0] != sysid}
        self._unanswered = {key for key in self._unanswered if key[0] != sysid}

    def value(self, sysid: int, name: str) -> float | None:
        """What a parameter was when it was told last; None where it never was."""
        known = self._known.get((sysid, name))
        return known.value if known is not None else None

    def is_settled(self, sysid: int, name: str) -> bool:
        """Whether a parameter is known, or was asked for in vain as often as is asked: the vehicle does not have it."""
        return (sysid, name) in self._known or (sysid, name) in self._unanswered

    def due(self, now_s: float) -> list[ParameterRequest]:
        """The requests that are to be asked by now."""
        out = []
        for (sysid, name), pending in self._requested.items():
            if pending.tries < _READ_TRIES and now_s >= pending.due_s:
                pending.tries += 1
                if pending.tries == _READ_TRIES:
                    self._unanswered.add((sysid, name))
                pending.due_s = now_s + (RETRY_S if pending.tries < _READ_TRIES else _FRESH_S)
                out.append(ParameterRequest(sysid, name))
        return out
