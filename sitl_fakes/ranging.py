"""Ranging devices: true slant range between two aircraft, made as bad as the scenario says."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from sitl_fakes.faults import Fault, RangeBias, RangeDropout, RangeStuck
from sitl_fakes.geodesy import Vector
from sitl_fakes.noise import Purpose, stream
from sitl_fakes.scenario import Ranging

_EPSILON_S = 1e-9


@dataclass(frozen=True, slots=True)
class RangeSample:
    """One measured range (m) to a peer, with the standard deviation that the device states (m, 0 unknown) and its number."""

    peer: int
    range_m: float
    stated_sigma_m: float
    sequence: int


class Ranger:
    """The ranging device of one aircraft: measures to each of its peers in turn, `rate_hz` each, evenly spread over the
    period.
    """

    def __init__(self, settings: Ranging, sysid: int, peers: Sequence[int], seed: int) -> None:
        self._settings = settings
        self._rng = stream(seed, Purpose.RANGES, sysid)
        period = 1.0 / settings.rate_hz
        self._due_s = {peer: k * period / len(peers) for k, peer in enumerate(peers)}
        self._sequence = dict.fromkeys(peers, 0)
        self._last_m: dict[int, float] = {}
        self._bias_m = {
            peer: settings.bias_sigma_m * float(stream(seed, Purpose.PAIR_BIAS, *sorted((sysid, peer))).standard_normal())
            for peer in peers
        }

    def measure(self, at_s: float, own_m: Vector, others_m: Mapping[int, Vector], faults: Iterable[Fault]) -> list[RangeSample]:
        """Return what the device reports at a time: positions are true, east, north, up in m. A peer without one is not
        there.
        """
        due = [peer for peer, due_s in self._due_s.items() if due_s <= at_s + _EPSILON_S]
        if not due:
            return []
        present = list(faults)
        samples = []
        for peer in due:
            self._due_s[peer] += 1.0 / self._settings.rate_hz
            peer_m = others_m.get(peer)
            sample = None if peer_m is None else self._measure_one(peer, math.dist(own_m, peer_m), present)
            if sample is not None:
                samples.append(sample)
        return samples

    def _measure_one(self, peer: int, true_m: float, faults: Sequence[Fault]) -> RangeSample | None:
        s = self._settings
        number = self._sequence[peer]
        self._sequence[peer] = (number + 1) & 0xFFFF
        measured = true_m + self._bias_m[peer] + s.sigma_m * float(self._rng.standard_normal())
        chance_lost, chance_outlier, how_long = self._rng.random(3).tolist()
        if chance_outlier < s.outlier_share:
            measured += s.outlier_min_m + how_long * (s.outlier_max_m - s.outlier_min_m)
        if true_m > s.max_range_m or chance_lost < s.loss:
            return None
        for fault in faults:
            if not isinstance(fault, RangeDropout | RangeBias | RangeStuck) or fault.peer not in (None, peer):
                continue
            if isinstance(fault, RangeDropout):
                return None
            measured = measured + fault.bias_m if isinstance(fault, RangeBias) else self._last_m.get(peer, measured)
        measured = max(measured, 0.01)
        self._last_m[peer] = measured
        return RangeSample(peer, measured, s.sigma_m if s.stated_sigma_m is None else s.stated_sigma_m, number)
