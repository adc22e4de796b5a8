"""Isolation: which faults explain a contradiction of ranges and positions, and who is in all?

The positions are those that vehicles report. Detection (`fault_tests`) needs one test that fails; isolation needs that every
other explanation is clearly worse.

Hypotheses: every subset of up to half of the reporting vehicles is off by one common horizontal offset (spoofed alike); a pair's
ranges are off; a device's ranges are all too long by one length or by one factor, those that it measured or all of its vehicle.
Against an earlier epoch each of them either began since or was there already; a fault of ranges may have been of another size.
Whether the offset of an isolated vehicle has changed since is a test of its own.
An offset of a majority cannot be told from the opposite offset of the others: that the majority is right is assumed.

Beforehand a device that is off by a few metres is much likelier than a receiver that fails: one redundant range shows that
something is off, and not what.

Isolated is a vehicle that is in every explanation which is not clearly worse than the best. Else the fault is only detected.
Before that, two receivers that are off at once, each its own way, are an explanation as well, and so are the pairs of several
that are off alike.

Source: J. Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans. AES 51 (2015), subsets of faults; N. L. Knight,
J. Wang and C. Rizos, Generalised measures of reliability for multiple outliers, J. Geodesy 84 (2010), separability.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import exp, hypot, inf

import numpy as np

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, Past
from gcs_coloc.core.integrity.epoch_tests.fault_model import AdjustedHypothesis, FaultKind, FaultModel, Hypothesis
from gcs_coloc.core.integrity.epoch_tests.fault_tests import REST_LEVEL, RULED_OUT_MARGIN, adjust, chi2_limit
from gcs_coloc.core.integrity.epoch_tests.pair_outliers import cost_of_their_pairs, cost_of_two_pairs
from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.core.stations.node_id import is_station

MAX_CANDIDATES = 8
"""Vehicles of which some may be at fault together. Chosen: bounds the number of subsets to 162."""
MAX_SUBSET = 4
"""So many of them at most. Chosen: with eight candidates that is half of them."""
_ALIKE_PENALTY = 3.2  # twice the log of 5: chosen, so much rarer is each further receiver spoofed alike; of four below the margin
_UNLIKE_PENALTY = 13.8  # twice the log of 1000: chosen, so much rarer two receivers are off at once, each its own way
_LEAST_WITH_TWO_FAULTY = 4  # receivers of which two are no majority
_STATION_PENALTY = 9.2  # twice the log of 100: chosen, so much rarer a station stands elsewhere than a receiver fails
_SELF_REPORTED_PENALTY = 13.8  # twice the log of 1000: chosen, so much likelier at fault is who reports trouble himself
_USUAL_DEVICE_GAIN = 12.0  # twice the log of 400: chosen, so much oftener is a device off by some metres than a receiver
_USUAL_DEVICE_M = 4.0  # chosen: uncalibrated devices; to ranges all round a vehicle a peer looks alike that is off by 12 m
_OF_DEVICES = frozenset({FaultKind.DEVICE, FaultKind.SCALE})


@dataclass(frozen=True, slots=True)
class Isolation:
    """Result for one epoch, or one against an earlier one.

    `candidates`: the reporting vehicles that may be at fault; of many those that explain most. `plausible`: the explanations not
    clearly worse than the best, which comes first; none where not even the best leaves a consistent rest. `not_alone`: vehicles
    that two other faults at once, or errors of the moment, may only seem to have at another place. `device_m`: by how much a
    device is off where that alone explains, and the ranges clearly rule out every other fault; else 0. `changes_m`: by isolated
    vehicle how much its offset has changed since the earlier epoch; 0 where that is not clear, or where there is none.
    """

    candidates: tuple[int, ...]
    plausible: tuple[AdjustedHypothesis, ...] = ()
    device_m: float = 0.0
    not_alone: frozenset[int] = frozenset()
    changes_m: Mapping[int, float] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """Twice the negative log likelihood of the best explanation; infinite where there is none."""
        return self.plausible[0].cost if self.plausible else inf

    @property
    def is_of_one_pair(self) -> bool:
        """Whether the best explanation is one pair that is off, and every other one is a range fault too."""
        return self.is_range_fault and self.plausible[0].kind is FaultKind.PAIR

    @property
    def isolated(self) -> dict[int, float]:
        """The vehicles whose position is off in every plausible explanation, and the size of that in m.

        The size is that of the best explanation. Vehicles in `not_alone` are left out.
        """
        if not self.plausible:
            return {}
        common = frozenset.intersection(*(_faulty(each) for each in self.plausible)) - self.not_alone
        return dict.fromkeys(sorted(common), self.plausible[0].size_m)

    @property
    def possible(self) -> frozenset[int]:
        """The vehicles off in a plausible explanation that holds no smaller one; for others see `also`."""
        return frozenset().union(*(faulty for faulty, _ in self._smallest))

    @property
    def also(self) -> dict[frozenset[int], float]:
        """Receivers that may be off besides those of a smaller explanation, each set with its odds.

        Nothing shows that they are off: the ranges fit without it. The odds are those beside the smaller explanation, at most 1.
        """
        also: dict[frozenset[int], float] = {}
        for explanation in self.plausible:
            faulty = _faulty(explanation)
            for smaller, cost in self._smallest:
                if smaller < faulty:
                    odds = exp(-0.5 * max(explanation.cost - cost, 0.0))
                    also[faulty - smaller] = max(also.get(faulty - smaller, 0.0), odds)
        return also

    @property
    def _smallest(self) -> list[tuple[frozenset[int], float]]:
        """The vehicles of the plausible faults of positions that hold no other one, each with its cost."""
        faults = [(faulty, each.cost) for each in self.plausible if (faulty := _faulty(each))]
        return [(faulty, cost) for faulty, cost in faults if not any(other < faulty for other, _ in faults)]

    @property
    def is_range_fault(self) -> bool:
        """Whether every plausible explanation is a fault of ranges: the positions agree without it."""
        return bool(self.plausible) and not self.possible


@dataclass(slots=True)
class IsolationPersistence:
    """How many samples in a row have isolated each vehicle, and have held it possible.

    They are independent samples of one interval. `sampled_until_s` is the end of the last sample's window. `explained` are the
    vehicles that the last sample's explanations allow to be at fault; None where it has none, or was consistent.
    """

    isolated: Counter[int] = field(default_factory=Counter)
    possible: Counter[int] = field(default_factory=Counter)
    explained: frozenset[int] | None = None
    sampled_until_s: float = float("-inf")

    def add(self, sample: Isolation, suspects: Collection[int]) -> None:
        """Add one sample; the `suspects` are possible where nothing explains it."""
        self.explained = sample.possible if sample.plausible else None
        possible = suspects if self.explained is None else self.explained
        self.isolated = Counter({v: self.isolated[v] + 1 for v in sample.isolated})
        self.possible = Counter({v: self.possible[v] + 1 for v in possible})

    def reset(self) -> None:
        """Begin to count anew."""
        self.isolated.clear()
        self.possible.clear()
        self.explained = None


def isolate(now: Epoch, past: Past, troubled: Collection[int] = (), *, pairs_fail: bool = False) -> Isolation:
    """Explain what an epoch, alone or against an earlier one, contradicts.

    `troubled` vehicles report trouble themselves. `pairs_fail`: pairs have been off of late; two may be at once, and no error of
    the ranges is sure to have been the same in the earlier epoch.
    """
    model = FaultModel(now, past)
    candidates = _candidates(now, model)
    hypotheses = _hypotheses(now, model, candidates)
    found = model.explain(hypotheses, [_penalty(each, frozenset(troubled)) for each in hypotheses])
    explanations = sorted((_with_usual_devices(each) for each in found), key=lambda each: each.cost)
    reporting = tuple(model.arrays.vehicles[at] for at in candidates)
    if not explanations:
        return Isolation(reporting)
    best = explanations[0]
    dof = best.degrees_of_freedom
    if dof and best.statistic > chi2_limit(dof, REST_LEVEL):
        return Isolation(reporting)
    limit = best.cost + RULED_OUT_MARGIN
    isolation = Isolation(reporting, tuple(each for each in explanations if each.cost <= limit), _device_m(found))
    not_alone = {
        vehicle
        for vehicle in isolation.isolated
        if vehicle not in troubled
        and (
            any(cost <= limit for cost in _costs_of_two_receivers(now, past, reporting, sound=vehicle))
            or (pairs_fail and cost_of_two_pairs(now, past, vehicle) <= limit)
        )
    }
    if pairs_fail and isolation.isolated and past[0] is not None:
        anew = isolate(_with_errors_anew(now), (_with_errors_anew(past[0]), past[1]), troubled)
        not_alone |= isolation.isolated.keys() - anew.isolated.keys()
    alike = [each.vehicles for each in isolation.plausible if len(each.vehicles) > 1] if isolation.isolated else []
    if any(cost_of_their_pairs(now, past, vehicles) <= limit for vehicles in alike):
        not_alone |= isolation.isolated.keys() - frozenset(troubled)
    isolation = replace(isolation, not_alone=frozenset(not_alone))
    return replace(isolation, changes_m={v: _change_m(now, past, model, v) for v in isolation.isolated})


def _with_errors_anew(epoch: Epoch) -> Epoch:
    """Return the epoch where the errors of ranges that would last are of this epoch alone."""
    anew = (r._replace(sigma_m=hypot(r.sigma_m, r.bias_m, r.devices_m), bias_m=0.0, devices_m=0.0) for r in epoch.residuals)
    return epoch.with_noise(epoch.priors, tuple(anew))


def _change_m(now: Epoch, past: Past, model: FaultModel, vehicle: int) -> float:
    """Return by how much the offset of a vehicle has changed since the earlier epoch, in m.

    It is 0 where one offset for both epochs fits nearly as well as one for each, or where there is no earlier epoch.
    """
    then, correlation = past
    if then is None:
        return 0.0
    moved = np.tile(np.array(model.arrays.vehicles) == vehicle, (model.epochs, 1)).astype(float)
    one_offset = Hypothesis(FaultKind.POSITIONS, (vehicle,), moved, np.zeros((model.epochs * model.rows, 2)))
    explained = model.explain([one_offset], [0.0])
    two_offsets = adjust(now.without_priors((vehicle,)), [(then.without_priors((vehicle,)), correlation)])[0]
    if explained and explained[0].statistic - two_offsets.statistic <= chi2_limit(2, REST_LEVEL):
        return 0.0
    return two_offsets.change_m(vehicle)


def cost_of_two_receivers(now: Epoch, past: Past, candidates: Sequence[int]) -> float:
    """Return the least cost of the explanation that two receivers are off, each its own way.

    They are two of the candidates. Infinite where two are a majority of all: that the majority is right is assumed.
    """
    return min(_costs_of_two_receivers(now, past, candidates), default=inf)


def _costs_of_two_receivers(now: Epoch, past: Past, candidates: Sequence[int], *, sound: int | None = None) -> Iterator[float]:
    """Yield the cost of each two of the candidates, of which `sound` is none."""
    then, correlation = past
    others = [vehicle for vehicle in candidates if vehicle != sound]
    for two in combinations(others, 2) if len(candidates) >= _LEAST_WITH_TWO_FAULTY else ():
        before = then.without_priors(two) if then is not None else None
        [fit] = adjust(now.without_priors(two), [(before, correlation)])
        yield fit.statistic + _UNLIKE_PENALTY + _STATION_PENALTY * sum(map(is_station, two))


def _faulty(explanation: AdjustedHypothesis) -> frozenset[int]:
    return frozenset(explanation.vehicles if explanation.kind is FaultKind.POSITIONS else ())


def _with_usual_devices(explanation: AdjustedHypothesis) -> AdjustedHypothesis:
    """Return the explanation; it costs less if a device's usual error leaves a consistent rest."""
    dof = explanation.degrees_of_freedom
    is_usual = explanation.kind in _OF_DEVICES and explanation.size_m <= _USUAL_DEVICE_M
    if not is_usual or (dof and explanation.statistic > chi2_limit(dof, REST_LEVEL)):
        return explanation
    return replace(explanation, cost=explanation.cost - _USUAL_DEVICE_GAIN)


def _device_m(found: Sequence[AdjustedHypothesis]) -> float:
    """Return by how much a device is off, m; 0 unless the ranges tell that from every other fault."""
    best = found[0]
    others = min((each.cost for each in found if each.kind not in _OF_DEVICES), default=inf)
    is_clear = best.kind in _OF_DEVICES and best.degrees_of_freedom > 0 and others > best.cost + RULED_OUT_MARGIN
    return best.size_m if is_clear else 0.0


def _penalty(hypothesis: Hypothesis, troubled: frozenset[int]) -> float:
    """Return twice the log of how much less likely a hypothesis is beforehand than one faulty receiver."""
    is_troubled = hypothesis.kind is FaultKind.POSITIONS and troubled.issuperset(hypothesis.vehicles)
    further = len(hypothesis.vehicles) - 1 if hypothesis.kind is FaultKind.POSITIONS else 0
    stations = sum(map(is_station, hypothesis.vehicles)) if hypothesis.kind is FaultKind.POSITIONS else 0
    return (
        _ALIKE_PENALTY * further + _STATION_PENALTY * stations + (_SELF_REPORTED_PENALTY if troubled and not is_troubled else 0.0)
    )


def _candidates(now: Epoch, model: FaultModel) -> list[int]:
    """Return the places of the reporting vehicles; of too many, of those whose fault explains most."""
    reporting = [at for at, vehicle in enumerate(model.arrays.vehicles) if not now.priors[vehicle].no_prior]
    if len(reporting) <= MAX_CANDIDATES:
        return reporting
    gains = model.linear_gains()
    return sorted(sorted(reporting, key=lambda at: -gains[at])[:MAX_CANDIDATES])


def _hypotheses(now: Epoch, model: FaultModel, candidates: Sequence[int]) -> list[Hypothesis]:
    """Return the hypotheses of faults in the present epoch, and in both where there is an earlier one."""
    arrays = model.arrays
    found: list[Hypothesis] = []

    def add(kind: FaultKind, who: tuple[int, ...], moved: FloatArray | float = 0.0, lengthened: FloatArray | float = 0.0) -> None:
        for lasting in range(1, model.epochs + 1):
            moved_in = np.zeros((model.epochs, model.vehicles))
            lengthened_in = np.zeros((model.epochs, model.rows, 2))
            for epoch in range(lasting):
                moved_in[epoch] = moved
                lengthened_in[epoch, :, epoch] = lengthened
            found.append(Hypothesis(kind, who, moved_in, lengthened_in.reshape(-1, 2)))

    reporting = sum(not now.priors[vehicle].no_prior for vehicle in arrays.vehicles)
    for size in range(1, min(reporting // 2, len(candidates), MAX_SUBSET) + 1):
        for subset in combinations(candidates, size):
            moved = np.zeros(model.vehicles)
            moved[list(subset)] = 1.0
            add(FaultKind.POSITIONS, tuple(arrays.vehicles[at] for at in subset), moved=moved)
    scale = arrays.ranges_m / float(arrays.ranges_m.mean())
    seen = set[bytes]()
    for owner in arrays.vehicles:
        measured = np.array([float(i == owner) for i, _ in arrays.pairs])
        either = np.array([float(owner in pair) for pair in arrays.pairs])
        for rows_of in (measured, either):
            if rows_of.sum() > 1 and rows_of.tobytes() not in seen:
                seen.add(rows_of.tobytes())
                add(FaultKind.DEVICE, (owner,), lengthened=rows_of)
                add(FaultKind.SCALE, (owner,), lengthened=rows_of * scale)
    for pair in sorted({tuple(sorted(pair)) for pair in arrays.pairs}):
        add(FaultKind.PAIR, pair, lengthened=np.array([float(set(each) == set(pair)) for each in arrays.pairs]))
    return found
