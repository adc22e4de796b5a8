"""Warnings about system ids that are heard from a second address."""

from __future__ import annotations

from gcs_coloc.links.base import Route

WARN_EVERY_S = 10.0
"""Per vehicle. Chosen: a pretender may send a hundred frames a second, and a person can use one line in this time."""


class AddressConflicts:
    """Collects refused senders and moves until they are warned of, one of each kind for each system id."""

    def __init__(self) -> None:
        self._refused: dict[int, tuple[Route, Route, int]] = {}
        self._moved: dict[int, tuple[Route, Route]] = {}
        self._warned_at_s: dict[int, float] = {}

    def add_refusal(self, sysid: int, bound: Route, other: Route) -> None:
        """A frame of `sysid`, which is bound to `bound`, was refused from `other`."""
        times = self._refused[sysid][2] if sysid in self._refused else 0
        self._refused[sysid] = (bound, other, times + 1)

    def add_move(self, sysid: int, before: Route, after: Route) -> None:
        """A vehicle, silent at one address, is heard from another one."""
        self._moved[sysid] = (before, after)

    def pending_warnings(self, now_s: float) -> list[tuple[int, str]]:
        """System id and text of the warnings that are due."""
        out = []
        for sysid in sorted(self._refused.keys() | self._moved.keys()):
            if now_s - self._warned_at_s.get(sysid, float("-inf")) < WARN_EVERY_S:
                continue
            self._warned_at_s[sysid] = now_s
            if sysid in self._moved:
                before, after = self._moved.pop(sysid)
                out.append((sysid, f"is heard from another address now: {after}, before from {before}"))
            if sysid in self._refused:
                out.append((sysid, _refusal_warning(*self._refused.pop(sysid))))
        return out


def _refusal_warning(bound: Route, other: Route, times: int) -> str:
    return (
        f"another sender uses its system id and is refused ({times} times): {other}; it is heard at {bound}. Give every vehicle "
        "its own system id (SYSID_THISMAV or MAV_SYSID); one with two radios is used over the first of them until that is "
        "silent; a companion of its own needs "
        "senders.companions_elsewhere; otherwise, somebody is pretending"
    )
