"""Counting what happened to the bytes of a link, by reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

MAX_REASONS = 256
OTHER = "other"


class Counts(Mapping[str, int]):
    """How often each reason occurred. At most `MAX_REASONS` reasons are kept apart; beyond them all go to "other"."""

    def __init__(self) -> None:
        self._by_reason: dict[str, int] = {}

    def add(self, reason: str, times: int = 1) -> None:
        """Count `reason` as having occurred `times` more times."""
        by_reason = self._by_reason
        if reason in by_reason:
            by_reason[reason] += times
            return
        if len(by_reason) >= MAX_REASONS:
            reason = OTHER
        by_reason[reason] = by_reason.get(reason, 0) + times

    def __getitem__(self, reason: str) -> int:
        return self._by_reason.get(reason, 0)

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_reason)

    def __len__(self) -> int:
        return len(self._by_reason)

    def __contains__(self, reason: object) -> bool:
        return reason in self._by_reason

    def __repr__(self) -> str:
        return f"Counts({self._by_reason})"
