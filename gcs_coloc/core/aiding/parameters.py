"""Parameters of the vehicles: requested when they are needed, and kept as last reported.

Each request is repeated a few times while no answer comes.
"""

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
    """A request. `is_over`: it was answered, or repeated in vain.

    From `due_s` on it may then be made anew.
    """

    due_s: float
    tries: int = 0
    is_over: bool = False


class Parameters:
    """What the vehicles of one fleet have told of the parameters that somebody wants to know."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, str], ParameterValue] = {}
        self._requested: dict[tuple[int, str], _PendingRequest] = {}
        self._unanswered: set[tuple[int, str]] = set()

    def request(self, sysid: int, name: str, now_s: float) -> None:
        """Request a parameter that is not known, or was reported long ago.

        Somebody else may have changed it since. `due` returns the request.
        """
        key = (sysid, name)
        known, pending = self._known.get(key), self._requested.get(key)
        if known is not None and now_s - known.received_at_s < _FRESH_S:
            return
        if pending is None or (pending.is_over and now_s >= pending.due_s):
            self._requested[key] = _PendingRequest(now_s)

    def add(self, message: ParameterValue) -> None:
        """Add what a vehicle reports; a parameter that nobody wants is passed over."""
        key = (message.sysid, message.name)
        if key in self._requested:
            self._known[key] = message
            self._unanswered.discard(key)
            self._requested[key] = _PendingRequest(message.received_at_s + _FRESH_S, is_over=True)

    def forget(self, sysid: int) -> None:
        """Forget the parameters of a vehicle that was rebooted: they may have changed."""
        self._known = {key: value for key, value in self._known.items() if key[0] != sysid}
        self._requested = {key: pending for key, pending in self._requested.items() if key[0] != sysid}
        self._unanswered = {key for key in self._unanswered if key[0] != sysid}

    def value(self, sysid: int, name: str) -> float | None:
        """Return the value of a parameter as last reported; None where it never was."""
        known = self._known.get((sysid, name))
        return known.value if known is not None else None

    def is_settled(self, sysid: int, name: str) -> bool:
        """Return whether a parameter is known, or was requested in vain.

        A vehicle that answers no request for a parameter counts as not having it.
        """
        return (sysid, name) in self._known or (sysid, name) in self._unanswered

    def due(self, now_s: float) -> list[ParameterRequest]:
        """Return the requests that are to be sent by now."""
        out = []
        for (sysid, name), pending in self._requested.items():
            if pending.is_over or now_s < pending.due_s:
                continue
            if pending.tries == _READ_TRIES:
                # The last one has had its time, too.
                pending.is_over, pending.due_s = True, now_s + _FRESH_S
                self._unanswered.add((sysid, name))
                continue
            pending.tries, pending.due_s = pending.tries + 1, now_s + RETRY_S
            out.append(ParameterRequest(sysid, name))
        return out
