"""One figure of a benchmark: what was measured, against what goal, and whether it was reached."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figure:
    """A value with its goal in words; `reached` is None where there is no goal."""

    name: str
    value: str
    goal: str = ""
    reached: bool | None = None


def interleaved(takers: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, float]:
    """The median of what each measurement gives, taken in turn (A B A B): a machine that is busy for a while is so for all."""
    taken: dict[str, list[float]] = {name: [] for name in takers}
    for _ in range(repeats):
        for name, take in takers.items():
            taken[name].append(take())
    return {name: statistics.median(values) for name, values in taken.items()}
