"""Parameters of the vehicles: requested a few times where somebody wants to know one, and kept as they were told last."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.messages.inbound import ParameterValue
from gcs_coloc.core.messages.outbound import ParameterRequest

RETRY_S = 1.0
"""Chosen: longer than a slow radio takes for question and answer."""
_READ_TRIES = 3  # chosen: nothing hangs on a value that is read
_FRESH_S = 30.0  # chosen: somebody else may change a parameter in flight; one question in so long costs a radio nothing


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
