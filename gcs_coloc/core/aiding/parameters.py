"""Parameters of vehicles: asked for by name, again where no answer comes, and never for ever."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.messages.aiding import ParameterRequest, ParameterValue

RETRY_S = 1.0
_TRIES = 3
_FRESH_S = 30.0


@dataclass(slots=True)
class _Question:
    due_s: float
    tries: int = 0


class Parameters:
    """What the vehicles of one fleet have told of the parameters that somebody wants to know."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, str], ParameterValue] = {}
        self._asked: dict[tuple[int, str], _Question] = {}

    def want(self, sysid: int, name: str, now_s: float) -> None:
        """Have a parameter asked for where it is not known or was told long ago: somebody else may have changed it since."""
        key = (sysid, name)
        known, question = self._known.get(key), self._asked.get(key)
        if known is not None and now_s - known.received_at_s < _FRESH_S:
            return
        if question is None or (question.tries >= _TRIES and now_s >= question.due_s):
            self._asked[key] = _Question(now_s)

    def heard(self, message: ParameterValue) -> None:
        """Take what a vehicle tells; a parameter that nobody wants is passed over."""
        key = (message.sysid, message.name)
        if key in self._asked:
            self._known[key] = message
            self._asked[key].tries, self._asked[key].due_s = _TRIES, message.received_at_s + _FRESH_S

    def forget(self, sysid: int) -> None:
        """The vehicle was rebooted: what it told before may hold no more."""
        self._known = {key: value for key, value in self._known.items() if key[0] != sysid}
        self._asked = {key: question for key, question in self._asked.items() if key[0] != sysid}

    def value(self, sysid: int, name: str) -> float | None:
        """What a parameter was when it was told last; None where it never was."""
        known = self._known.get((sysid, name))
        return known.value if known is not None else None

    def due(self, now_s: float) -> list[ParameterRequest]:
        """The questions that are to be asked by now."""
        out = []
        for (sysid, name), question in self._asked.items():
            if question.tries < _TRIES and now_s >= question.due_s:
                question.tries += 1
                question.due_s = now_s + (RETRY_S if question.tries < _TRIES else _FRESH_S)
                out.append(ParameterRequest(sysid, name))
        return out
