"""Who may be at fault over time, while a fault is detected and not isolated."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from math import exp

from gcs_coloc.core.integrity.epoch_tests.isolation import Isolation

_CLEARED_AFTER_S = 6.0
"""So long after the ranges last allowed a vehicle to be at fault it is detected no more. Chosen: four samples that share no
range, each of which holds it against all that it explains."""


class Detection:
    """The vehicles among which a fault is, and what else may be off.

    `vehicles` are those that the tests of epochs allow to be at fault, and those that the fault monitor names. Times are service
    time, s.
    """

    def __init__(self) -> None:
        self.vehicles: frozenset[int] = frozenset()
        self._possible_until_s: dict[int, float] = {}
        self._monitored_until_s: dict[int, float] = {}
        self._also: dict[float, dict[frozenset[int], float]] = {}

    def add_monitored(self, found: Collection[int], now_s: float, hold_s: float) -> None:
        """Add the vehicles that the fault monitor names, each for so long (s)."""
        self._monitored_until_s |= dict.fromkeys(found, now_s + hold_s)
        self._monitored_until_s = {v: until_s for v, until_s in self._monitored_until_s.items() if until_s > now_s}
        self.vehicles |= frozenset(self._monitored_until_s)

    def add_samples(
        self,
        samples: Mapping[float, Isolation],
        explained: Sequence[frozenset[int]],
        suspected: Iterable[int],
        now_s: float,
    ) -> None:
        """Add what independent samples show, by interval (s), none of them a fault of ranges alone.

        `explained` are the vehicles that the last sample of each interval allows to be at fault, `suspected` those that several
        samples of one in a row do.
        """
        if not samples:
            return
        self._also |= {interval_s: sample.also for interval_s, sample in samples.items()}
        # One fault explains the contradictions at all intervals.
        suspected = frozenset(suspected)
        in_all = {v for v in suspected | self._possible_until_s.keys() if all(v in each for each in explained)}
        self._possible_until_s |= dict.fromkeys(in_all or suspected, now_s + _CLEARED_AFTER_S)
        self._possible_until_s = {v: until_s for v, until_s in self._possible_until_s.items() if until_s > now_s}
        self.vehicles = frozenset(self._possible_until_s.keys() | self._monitored_until_s.keys())

    def limit_to(self, vehicles: Collection[int], now_s: float) -> None:
        """Have these vehicles alone of what the tests of epochs show: they say that all others are right.

        What the fault monitor names goes on: it knows more of the past, and for some seconds an anchor less costs little.
        """
        self._possible_until_s, self._also = dict.fromkeys(vehicles, now_s + _CLEARED_AFTER_S), {}
        self.vehicles = frozenset(vehicles) | self._monitored_until_s.keys()

    def remove(self, identified: Collection[int]) -> None:
        """Remove identified vehicles, and end what the tests of epochs have shown: their fault explains it."""
        for vehicle in identified:
            self._monitored_until_s.pop(vehicle, None)
        self.end_of_tests()

    def end_of_tests(self) -> None:
        """End what the tests of epochs have shown; what the fault monitor names goes on."""
        self._possible_until_s, self._also = {}, {}
        self.vehicles = frozenset(self._monitored_until_s)

    def also(self, in_use: Collection[int], margin: float) -> dict[frozenset[int], float] | None:
        """Return the receivers in use that may be faulty besides `vehicles`, each set with its odds.

        They may also be faulty instead. Nothing shows that they are. What was ruled out is so by the margin of the isolation
        (twice a log likelihood) and no more: the odds are the most that this leaves. None where no fault is detected.
        """
        if not self.vehicles:
            return None
        likeliest = {frozenset((v,)): exp(-0.5 * margin) for v in in_use if v not in self.vehicles}
        for vehicles, odds in (each for also in self._also.values() for each in also.items()):
            likeliest[vehicles] = max(likeliest.get(vehicles, 0.0), odds)
        return likeliest
