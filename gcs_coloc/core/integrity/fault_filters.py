"""Who lies since when, and how far has it dragged a vehicle without GPS? One small filter for nobody and one for each candidate.

The state of each filter is where the vehicle is beside its estimated place (east, north); for each peer the error of its claim
along the line between the two, which wanders as a Gauss-Markov process; and a lie: its size along the line and its rate. A filter
in which a peer lies is begun anew out of the honest one at every step, with the chance that a lie began just then, and merged
with what it held before: so a walk is weighed since whenever it began, against how far honest errors wander in that time. The
weights of the filters are the chances of their hypotheses. The last hypothesis is that the vehicle's own ranging device is off,
all ranges by one length.

The vehicle's own motion is hardly used: its place may come to be off by metres between two steps, so that the outcome does not
hang on what an estimator believes of the motion.

Source: multiple-model estimation with merging (Blom and Bar-Shalom, 1988); failures that begin at an unknown time (Willsky and
Jones, 1976); bounded influence of single innovations (Huber, 1964).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import exp, hypot, log, pi, sqrt

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_UNKNOWN_M2 = 1e4
_NEVER = -700.0  # log of a chance that is none
_SIZE, _RATE = -2, -1
_FURTHEST_AHEAD = 3.0


@dataclass(frozen=True, slots=True)
class FaultFilterSettings:
    """What is assumed of lies, honest errors and ranges.

    `wander_time_s`: how long an honest error lasts. `begins_per_s`, `ends_per_s`: chances that a candidate's lie begins, or ends.
    `offset_m`, `rate_mps`: 1-sigma of what a lie begins with, along the line to the peer; `rate_density_m2ps3`: how its rate
    changes.
    `place_density_m2ps`: how fast the vehicle may come to be elsewhere than estimated; after `lost_after` steps at which a filter
    explains less than half of the lines it may be anywhere. Beyond `doubt_sigma` an innovation counts less, beyond `gate_sigma`
    it is not used. Where innovations are larger than stated over `noise_time_s`, the noise is.
    """

    wander_time_s: float = 30.0
    begins_per_s: float = 1.0 / 600.0
    ends_per_s: float = 1.0 / 3600.0
    offset_m: float = 1.0
    rate_mps: float = 1.5
    rate_density_m2ps3: float = 0.1
    place_density_m2ps: float = 4.0
    lost_after: int = 3
    doubt_sigma: float = 1.5
    gate_sigma: float = 3.0
    noise_time_s: float = 15.0
    longest_step_s: float = 3.0


@dataclass(frozen=True, slots=True)
class Line:
    """What is measured along the line to one peer.

    `residual_m`: the range beyond the distance of the places, `noise_m` its 1-sigma. `claim_m`: 1-sigma of the honest errors
    along the line. `unit`: the line's horizontal direction (east, north), from the peer.
    """

    residual_m: float
    noise_m: float
    claim_m: float
    unit: tuple[float, float]


@dataclass(frozen=True, slots=True)
class RampHypothesis:
    """One that somebody lies: how likely, and the second moment of how far the vehicle then is from where it would be if
    nobody did.

    `liar` is None for the vehicle's own ranging device. `moved_m2` is east with east, east with north, north with north.
    """

    liar: int | None
    chance: float
    moved_m2: tuple[float, float, float]


class FaultFilters:
    """The hypotheses about one vehicle without GPS. The order of filters: nobody, each of `peers`, the vehicle's own device."""

    def __init__(self, settings: FaultFilterSettings | None = None) -> None:
        self.settings = settings if settings is not None else FaultFilterSettings()
        self.at_s = float("-inf")
        self.peers: list[int] = []
        self._claim_m: dict[int, float] = {}
        self._noise: dict[int, float] = {}
        self._seen_s: dict[int, float] = {}
        self._clear(0)

    def _clear(self, peers: int) -> None:
        models, size = peers + 2, peers + 4
        # Of each filter the mean in row 0 and below it the covariance, so that one product or correction is of both.
        self._A: FloatArray = np.zeros((models, 1 + size, size))
        self._covariances[:, [0, 1], [0, 1]] = _UNKNOWN_M2
        self._log_chance = [0.0] + [_NEVER] * (models - 1)
        self._astray = [0] * models

    @property
    def _means(self) -> FloatArray:
        return self._A[:, 0]

    @property
    def _covariances(self) -> FloatArray:
        return self._A[:, 1:]

    def take(self, lines: Mapping[int, Line], at_s: float) -> None:
        """Take what was measured at one time, one line for each peer. Times increase from call to call."""
        s = self.settings
        for peer, line in lines.items():
            self._seen_s[peer], self._claim_m[peer] = at_s, line.claim_m
        peers = sorted(p for p, seen_s in self._seen_s.items() if at_s - seen_s <= s.longest_step_s)
        if peers != self.peers:
            self._regroup(peers)
        step_s = min(at_s - self.at_s, s.longest_step_s)
        self.at_s = at_s
        self._predict(step_s)
        self._let_begin(step_s)
        H, z = self._design(lines), [line.residual_m for line in lines.values()]
        r = [line.noise_m**2 * max(self._noise.setdefault(peer, 1.0), 1.0) for peer, line in lines.items()]
        self._find_again(H, z, r)
        gain = 1.0 - exp(-step_s / s.noise_time_s)
        for k, peer in enumerate(lines):
            self._noise[peer] *= 1.0 - gain + gain * self._correct(H[:, k], z[k], r[k])
        self._log_chance = _normalised(self._log_chance)

    def exclude(self, liars: Collection[int]) -> None:
        """Go on without the peers that are not believed any more, from what holds if the likeliest of them lies."""
        known = [p for p in self.peers if p in liars]
        if not known:
            return
        best = max((1 + self.peers.index(p) for p in known), key=self._log_chance.__getitem__)
        A = self._A[best].copy()
        A[_SIZE:] = A[:, _SIZE:] = 0.0
        self._A[:] = A
        self._log_chance = [0.0] + [_NEVER] * (len(self._A) - 1)
        for p in known:
            del self._seen_s[p]
        self._regroup([p for p in self.peers if p not in liars])

    def chances(self) -> list[tuple[int | None, float]]:
        """How likely it is of each who may lie that it does; None for the vehicle's own ranging device."""
        return list(zip([*self.peers, None], map(exp, self._log_chance[1:]), strict=True))

    def hypotheses(self, now_s: float) -> list[RampHypothesis]:
        """What may be, of those that somebody lies; a lie that grows is taken to have gone on doing so since the last lines."""
        out = []
        (east, north), *means = self._means[:, :2].tolist()
        lies = self._means[1:, _SIZE:].tolist()
        wider = (self._covariances[1:, :2, :2] - self._covariances[0, :2, :2]).tolist()
        for (liar, chance), (e, n), (size_m, rate_mps), ((ee, en), (_, nn)) in zip(
            self.chances(), means, lies, wider, strict=True
        ):
            grown = rate_mps * (now_s - self.at_s) / size_m if size_m != 0.0 else 0.0
            ahead = min(max(1.0 + grown, 1.0), _FURTHEST_AHEAD)
            e, n = (e - east) * ahead, (n - north) * ahead
            ee, en, nn = positive_part(ee, en, nn)
            out.append(RampHypothesis(liar, chance, (ee + e * e, en + e * n, nn + n * n)))
        return out

    def _regroup(self, peers: list[int]) -> None:
        """Go on with other peers; what is known of those that stay is kept."""
        old, x, P, log_chance = self.peers, self._means, self._covariances, self._log_chance
        self.peers = peers
        self._seen_s = {p: self._seen_s[p] for p in peers}
        self._clear(len(peers))
        stay = [p for p in peers if p in old]
        models = [[0, *(1 + group.index(p) for p in stay), len(group) + 1] for group in (peers, old)]
        states = [[0, 1, *(2 + group.index(p) for p in stay), len(group) + 2, len(group) + 3] for group in (peers, old)]
        self._means[np.ix_(models[0], states[0])] = x[np.ix_(models[1], states[1])]
        self._covariances[np.ix_(models[0], states[0], states[0])] = P[np.ix_(models[1], states[1], states[1])]
        for model, was in zip(*models, strict=True):
            self._log_chance[model] = log_chance[was]
        for k, p in enumerate(peers):
            if p not in old:
                self._covariances[:, 2 + k, 2 + k] = self._claim_m[p] ** 2
                self._A[1 + k] = self._A[0]
        self._log_chance = _normalised(self._log_chance)

    def _predict(self, step_s: float) -> None:
        s, A = self.settings, self._A
        models, _, size = A.shape
        keep = exp(-step_s / s.wander_time_s)
        kept = [1.0, 1.0, *[keep] * len(self.peers), 1.0, 1.0]
        A *= np.outer([1.0, *kept], kept)
        A[:, :, _SIZE] += step_s * A[:, :, _RATE]
        A[:, _SIZE] += step_s * A[:, _RATE]
        place_m2, fresh = s.place_density_m2ps * step_s, 1.0 - keep * keep
        variances = A.reshape(models, -1)[:, size :: size + 1]
        variances += [place_m2, place_m2, *[self._claim_m[p] ** 2 * fresh for p in self.peers], 0.0, 0.0]
        variances[1:, _RATE] += s.rate_density_m2ps3 * step_s

    def _let_begin(self, step_s: float) -> None:
        """Let each lie begin now, out of the honest filter, or end."""
        s, least = self.settings, exp(_NEVER)
        honest, *lying = map(exp, self._log_chance)
        begun = honest * s.begins_per_s * step_s
        going_on = [chance * (1.0 - s.ends_per_s * step_s) for chance in lying]
        fresh = self._A[0].copy()
        fresh[_SIZE, _SIZE], fresh[_RATE, _RATE] = s.offset_m**2, s.rate_mps**2
        share = np.array([begun / max(begun + chance, least) for chance in going_on])[:, np.newaxis, np.newaxis]
        merged = self._A[1:]
        off = fresh - merged
        apart = off[:, :1]
        merged += share * off
        merged[:, 1:] += share * (1.0 - share) * apart * apart.transpose(0, 2, 1)
        honest += sum(lying) - sum(going_on) - begun * len(lying)
        self._log_chance = [log(max(chance, least)) for chance in (honest, *(chance + begun for chance in going_on))]

    def _design(self, lines: Mapping[int, Line]) -> FloatArray:
        """Return what each line measures of the state: (models, lines, states)."""
        models, size = self._means.shape
        H: FloatArray = np.zeros((models, len(lines), size))
        for k, (peer, line) in enumerate(lines.items()):
            index = self.peers.index(peer)
            H[:, k, :2] = line.unit
            H[:, k, 2 + index] = 1.0
            H[1 + index, k, _SIZE] = 1.0
        H[-1, :, _SIZE] = 1.0
        return H

    def _find_again(self, H: FloatArray, z: list[float], r: list[float]) -> None:
        """Where a filter explains less than half of the lines, time and again, the place that it goes by has jumped."""
        columns = H.transpose(0, 2, 1)
        foreseen = self._A @ columns
        variance = (columns * foreseen[:, 1:]).sum(axis=1) + r
        beyond = ((z - foreseen[:, 0]) ** 2 > self.settings.gate_sigma**2 * variance).sum(axis=1).tolist()
        self._astray = [astray + 1 if 2 * n > len(z) else 0 for astray, n in zip(self._astray, beyond, strict=True)]
        for m, astray in enumerate(self._astray):
            if astray >= self.settings.lost_after:
                self._covariances[m, :2] = self._covariances[m, :, :2] = 0.0
                self._covariances[m, [0, 1], [0, 1]] = _UNKNOWN_M2

    def _correct(self, h: FloatArray, z: float, r: float) -> float:
        """Correct all filters with one line and weigh them by it; return its normalised square, 1 where the noise is true."""
        s, log_chance = self.settings, self._log_chance
        Ah = self._A @ h[:, :, np.newaxis]
        Ph = Ah[:, np.newaxis, 1:, 0]
        expected_m, known_m2 = Ah[:, 0, 0].tolist(), (Ph @ h[:, :, np.newaxis])[:, 0, 0].tolist()
        pulls, squares = [], []
        for m in range(len(log_chance)):
            variance = max(known_m2[m], 0.0) + r
            sigmas = min(abs(z - expected_m[m]) / sqrt(variance), s.gate_sigma)
            inner = min(sigmas, s.doubt_sigma)
            # Huber's weight, and none beyond the gate.
            pulls.append(s.doubt_sigma / max(sigmas, s.doubt_sigma) / variance if sigmas < s.gate_sigma else 0.0)
            squares.append(sigmas * sigmas)
            log_chance[m] -= inner * (sigmas - 0.5 * inner) + 0.5 * log(2.0 * pi * variance)
        Ah[:, 0] -= z
        self._A -= Ah * (np.array(pulls)[:, np.newaxis, np.newaxis] * Ph)
        return sum([exp(chance) * square for chance, square in zip(_normalised(log_chance), squares, strict=True)], start=0.0)


def _normalised(log_chance: list[float]) -> list[float]:
    """Return logarithms of chances less that of their sum."""
    most = max(log_chance)
    total = most + log(sum(exp(one - most) for one in log_chance))
    return [one - total for one in log_chance]


def positive_part(ee: float, en: float, nn: float) -> tuple[float, float, float]:
    """Return a symmetric (2, 2) matrix without what is negative of its eigenvalues."""
    mean, half = 0.5 * (ee + nn), hypot(0.5 * (ee - nn), en)
    if mean >= half:
        return ee, en, nn
    if mean <= -half:
        return 0.0, 0.0, 0.0
    smaller, part = mean - half, (mean + half) / (2.0 * half)
    return part * (ee - smaller), part * en, part * (nn - smaller)
