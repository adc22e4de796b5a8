"""Parameters of vehicles: asked for by name, again where no answer comes, and never for ever."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.messages.inbound import ParameterValue
from gcs_coloc.core.messages.outbound import ParameterRequest

RETRY_S = 1.0
_TRIES = 3
_FRESH_S = 30.0


@dataclass(slots=True)
class _PendingRequest:
    due_s: float
    tries: int = 0


class Parameters:
    """What the vehicles of one fleet have told of the parameters that somebody wants to know."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, str], ParameterValue] = {}
        self._requested: dict[tuple[int, str], _PendingRequest] = {}

    def request(self, sysid: int, name: str, now_s: float) -> None:
        """Request a parameter where it is not known or was told long ago: somebody else may have changed it since."""
        key = (sysid, name)
        known, pending = self._known.get(key), self._requested.get(key)
        if known is not None and now_s - known.received_at_s < _FRESH_S:
            return
        if pending is None or (pending.tries >= _TRIES and now_s >= pending.due_s):
            self._requested[key] = _PendingRequest(now_s)

    def add(self, message: ParameterValue) -> None:
        """Add what a vehicle reports; a parameter that nobody wants is passed over."""
        key = (message.sysid, message.name)
        if key in self._requested:
            self._known[key] = message
            self._requested[key].tries, self._requested[key].due_s = _TRIES, message.received_at_s + _FRESH_S

    def forget(self, sysid: int) -> None:
        """The vehicle was rebooted: what it told before may hold no more."""
        self._known = {key: value for key, value in self._known.items() if key[0] != sysid}
        self._requested = {key: pending for key, pending in self._requested.items() if key[0] != sysid}

    def value(self, sysid: int, name: str) -> float | None:
        """What a parameter was when it was told last; None where it never was."""
        known = self._known.get((sysid, name))
        return known.value if known is not None else None

    def due(self, now_s: float) -> list[ParameterRequest]:
        """The requests that are to be asked by now."""
        out = []
        for (sysid, name), pending in self._requested.items():
            if pending.tries < _TRIES and now_s >= pending.due_s:
                pending.tries += 1
                pending.due_s = now_s + (RETRY_S if pending.tries < _TRIES else _FRESH_S)
                out.append(ParameterRequest(sysid, name))
        return out
