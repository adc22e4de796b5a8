"""One figure of a benchmark: what was measured, against what goal, and whether it was reached."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """A value with its goal in words; `reached` is None where there is no goal."""

    section: str
    name: str
    value: str
    goal: str
    reached: bool | None
