"""Parameters of vehicles: requested a few times when they are needed, and kept as last reported."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.messages.inbound import ParameterValue
from gcs_coloc.core.messages.outbound import ParameterRequest

RETRY_S = 1.0
"""Chosen: longer than a slow radio takes for question and answer."""
_READ_TRIES = 3  # chosen: nothing hangs on a value that is read
_FRESH_S = 30.0  # chosen: somebody else may change a parameter in flight; one question in so long costs a radio nothing


@dataclass(slots=True)
class _Parameter:
    """One parameter of one vehicle that somebody wants to know.

    `reported`: as it was last reported. `due_s`: when it is requested next, or may be anew where the request `is_over`: answered,
    or repeated in vain. `is_unanswered`: no request since the last answer was answered.
    """

    due_s: float
    tries: int = 0
    is_over: bool = False
    is_unanswered: bool = False
    reported: ParameterValue | None = None


class Parameters:
    """What the vehicles of one fleet have told of the parameters that somebody wants to know."""

    def __init__(self) -> None:
        self._wanted: dict[tuple[int, str], _Parameter] = {}

    def request(self, sysid: int, name: str, now_s: float) -> None:
        """Request a parameter that is not known, or that somebody may have changed since it was reported."""
        wanted = self._wanted.setdefault((sysid, name), _Parameter(now_s))
        if wanted.is_over and now_s >= wanted.due_s:
            wanted.due_s, wanted.tries, wanted.is_over = now_s, 0, False

    def add(self, message: ParameterValue) -> None:
        """Add what a vehicle reports; a parameter that nobody wants is passed over."""
        wanted = self._wanted.get((message.sysid, message.name))
        if wanted is not None:
            wanted.reported, wanted.is_unanswered = message, False
            wanted.due_s, wanted.is_over = message.received_at_s + _FRESH_S, True

    def forget(self, sysid: int) -> None:
        """Forget the parameters of a vehicle that was rebooted: they may have changed."""
        self._wanted = {key: wanted for key, wanted in self._wanted.items() if key[0] != sysid}

    def value(self, sysid: int, name: str) -> float | None:
        """Return the value of a parameter as last reported; None where it never was."""
        wanted = self._wanted.get((sysid, name))
        return wanted.reported.value if wanted is not None and wanted.reported is not None else None

    def is_settled(self, sysid: int, name: str) -> bool:
        """Return whether a parameter is known, or was requested in vain: the vehicle does not have it."""
        wanted = self._wanted.get((sysid, name))
        return wanted is not None and (wanted.reported is not None or wanted.is_unanswered)

    def due(self, now_s: float) -> list[ParameterRequest]:
        """Return the requests that are to be sent by now."""
        out = []
        for (sysid, name), wanted in self._wanted.items():
            if wanted.is_over or now_s < wanted.due_s:
                continue
            if wanted.tries == _READ_TRIES:
                # The last one has had its time, too.
                wanted.is_over, wanted.due_s, wanted.is_unanswered = True, now_s + _FRESH_S, True
                continue
            wanted.tries, wanted.due_s = wanted.tries + 1, now_s + RETRY_S
            out.append(ParameterRequest(sysid, name))
        return out
