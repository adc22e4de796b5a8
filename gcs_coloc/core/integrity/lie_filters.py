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
from math import exp, pi

import numpy as np

from gcs_coloc.core.measurements import FloatArray

_UNKNOWN_M2 = 1e4
_NEVER = -700.0  # log of a chance that is none
_SIZE, _RATE = -2, -1
_FURTHEST_AHEAD = 3.0


@dataclass(frozen=True, slots=True)
class LieSettings:
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
class Hypothesis:
    """One that somebody lies: how likely, and the second moment (2, 2) of how far the vehicle then is from where it would be if
    nobody did.

    `liar` is None for the vehicle's own ranging device.
    """

    liar: int | None
    chance: float
    moved_m2: FloatArray


class LieFilters:
    """The hypotheses about one vehicle without GPS. The order of filters: nobody, each of `peers`, the vehicle's own device."""

    def __init__(self, settings: LieSettings | None = None) -> None:
        self.settings = settings if settings is not None else LieSettings()
        self.at_s = float("-inf")
        self.peers: list[int] = []
        self._claim_m: dict[int, float] = {}
        self._noise: dict[int, float] = {}
        self._seen_s: dict[int, float] = {}
        self._clear(0)

    def _clear(self, peers: int) -> None:
        models, size = peers + 2, peers + 4
        self._x: FloatArray = np.zeros((models, size))
        self._P: FloatArray = np.zeros((models, size, size))
        self._P[:, [0, 1], [0, 1]] = _UNKNOWN_M2
        self._log_chance: FloatArray = np.full(models, _NEVER)
        self._log_chance[0] = 0.0
        self._astray = np.zeros(models, dtype=int)

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
        H, z = self._design(lines), np.array([line.residual_m for line in lines.values()])
        r = np.array([line.noise_m**2 * max(self._noise.setdefault(peer, 1.0), 1.0) for peer, line in lines.items()])
        self._find_again(H, z, r)
        gain = 1.0 - exp(-step_s / s.noise_time_s)
        for k, peer in enumerate(lines):
            self._noise[peer] *= 1.0 - gain + gain * self._correct(H[:, k], float(z[k]), float(r[k]))
        self._log_chance -= np.logaddexp.reduce(self._log_chance)

    def exclude(self, liars: Collection[int]) -> None:
        """Go on without the peers that are not believed any more, from what holds if the likeliest of them lies."""
        known = [p for p in self.peers if p in liars]
        if not known:
            return
        best = max((1 + self.peers.index(p) for p in known), key=lambda model: float(self._log_chance[model]))
        x, P = self._x[best].copy(), self._P[best].copy()
        x[_SIZE:] = 0.0
        P[_SIZE:] = P[:, _SIZE:] = 0.0
        self._x[:], self._P[:] = x, P
        self._log_chance[:] = _NEVER
        self._log_chance[0] = 0.0
        for p in known:
            del self._seen_s[p]
        self._regroup([p for p in self.peers if p not in liars])

    def chances(self) -> list[tuple[int | None, float]]:
        """How likely it is of each who may lie that it does; None for the vehicle's own ranging device."""
        return list(zip([*self.peers, None], np.exp(self._log_chance[1:]).tolist(), strict=True))

    def hypotheses(self, now_s: float) -> list[Hypothesis]:
        """What may be, of those that somebody lies; a lie that grows is taken to have gone on doing so since the last lines."""
        x, honest = self._x[1:], self._x[0]
        size_m, rate_mps = x[:, _SIZE], x[:, _RATE]
        grown = np.divide(rate_mps * (now_s - self.at_s), size_m, out=np.zeros(len(x)), where=size_m != 0.0)
        moved_m = (x[:, :2] - honest[:2]) * np.clip(1.0 + grown, 1.0, _FURTHEST_AHEAD)[:, np.newaxis]
        values, axes = np.linalg.eigh(self._P[1:, :2, :2] - self._P[0, :2, :2])
        wider_m2 = (axes * np.maximum(values, 0.0)[:, np.newaxis]) @ axes.transpose(0, 2, 1)
        moved_m2 = moved_m[:, :, np.newaxis] * moved_m[:, np.newaxis] + wider_m2
        return [Hypothesis(liar, chance, m2) for (liar, chance), m2 in zip(self.chances(), moved_m2, strict=True)]

    def _regroup(self, peers: list[int]) -> None:
        """Go on with other peers; what is known of those that stay is kept."""
        old, x, P, log_chance = self.peers, self._x, self._P, self._log_chance
        self.peers = peers
        self._seen_s = {p: self._seen_s[p] for p in peers}
        self._clear(len(peers))
        stay = [p for p in peers if p in old]
        models = [[0, *(1 + group.index(p) for p in stay), len(group) + 1] for group in (peers, old)]
        states = [[0, 1, *(2 + group.index(p) for p in stay), len(group) + 2, len(group) + 3] for group in (peers, old)]
        self._x[np.ix_(models[0], states[0])] = x[np.ix_(models[1], states[1])]
        self._P[np.ix_(models[0], states[0], states[0])] = P[np.ix_(models[1], states[1], states[1])]
        self._log_chance[models[0]] = log_chance[models[1]]
        for k, p in enumerate(peers):
            if p not in old:
                self._P[:, 2 + k, 2 + k] = self._claim_m[p] ** 2
                self._x[1 + k], self._P[1 + k] = self._x[0], self._P[0]
        self._log_chance -= np.logaddexp.reduce(self._log_chance)

    def _predict(self, step_s: float) -> None:
        s, size = self.settings, self._P.shape[1]
        keep = exp(-step_s / s.wander_time_s)
        F = np.diag([1.0, 1.0, *[keep] * len(self.peers), 1.0, 1.0])
        F[_SIZE, _RATE] = step_s
        claims_m2 = np.square([self._claim_m[p] for p in self.peers])
        Q = np.zeros(size)
        Q[:2] = s.place_density_m2ps * step_s
        Q[2:_SIZE] = claims_m2 * (1.0 - keep * keep)
        self._x = self._x @ F.T
        self._P = F @ self._P @ F.T
        self._P[:, range(size), range(size)] += Q
        self._P[1:, _RATE, _RATE] += s.rate_density_m2ps3 * step_s

    def _let_begin(self, step_s: float) -> None:
        """Let each lie begin now, out of the honest filter, or end."""
        s, chance = self.settings, np.exp(self._log_chance)
        begun, going_on = chance[0] * s.begins_per_s * step_s, chance[1:] * (1.0 - s.ends_per_s * step_s)
        fresh_x, fresh_P = self._x[0].copy(), self._P[0].copy()
        fresh_P[_SIZE, _SIZE], fresh_P[_RATE, _RATE] = s.offset_m**2, s.rate_mps**2
        share = (begun / np.maximum(begun + going_on, exp(_NEVER)))[:, np.newaxis]
        x = share * fresh_x + (1.0 - share) * self._x[1:]
        off, kept_off, part = fresh_x - x, self._x[1:] - x, share[:, :, np.newaxis]
        self._P[1:] = part * (fresh_P + off[:, :, np.newaxis] * off[:, np.newaxis]) + (1.0 - part) * (
            self._P[1:] + kept_off[:, :, np.newaxis] * kept_off[:, np.newaxis]
        )
        self._x[1:] = x
        chance[0] += float(np.sum(chance[1:] - going_on)) - begun * len(going_on)
        chance[1:] = going_on + begun
        self._log_chance = np.log(np.maximum(chance, exp(_NEVER)))

    def _design(self, lines: Mapping[int, Line]) -> FloatArray:
        """Return what each line measures of the state: (models, lines, states)."""
        models, size = self._x.shape
        H: FloatArray = np.zeros((models, len(lines), size))
        for k, (peer, line) in enumerate(lines.items()):
            index = self.peers.index(peer)
            H[:, k, :2] = line.unit
            H[:, k, 2 + index] = 1.0
            H[1 + index, k, _SIZE] = 1.0
        H[-1, :, _SIZE] = 1.0
        return H

    def _find_again(self, H: FloatArray, z: FloatArray, r: FloatArray) -> None:
        """Where a filter explains less than half of the lines, time and again, the place that it goes by has jumped."""
        variance = np.einsum("mki,mij,mkj->mk", H, self._P, H) + r
        beyond = (z - np.einsum("mki,mi->mk", H, self._x)) ** 2 > self.settings.gate_sigma**2 * variance
        self._astray = np.where(2 * beyond.sum(axis=1) > len(z), self._astray + 1, 0)
        for m in np.flatnonzero(self._astray >= self.settings.lost_after):
            self._P[m, :2] = self._P[m, :, :2] = 0.0
            self._P[m, [0, 1], [0, 1]] = _UNKNOWN_M2

    def _correct(self, h: FloatArray, z: float, r: float) -> float:
        """Correct all filters with one line and weigh them by it; return its normalised square, 1 where the noise is true."""
        s = self.settings
        Ph = np.einsum("mij,mj->mi", self._P, h)
        S = np.einsum("mi,mi->m", h, Ph) + r
        miss = z - np.einsum("mi,mi->m", h, self._x)
        sigmas = np.minimum(np.abs(miss) / np.sqrt(S), s.gate_sigma)
        trust = np.where(sigmas < s.gate_sigma, s.doubt_sigma / np.maximum(sigmas, s.doubt_sigma), 0.0)
        gain = (trust / S)[:, np.newaxis] * Ph
        self._x += gain * miss[:, np.newaxis]
        self._P -= gain[:, :, np.newaxis] * Ph[:, np.newaxis]
        inner = np.minimum(sigmas, s.doubt_sigma)
        self._log_chance -= inner * (sigmas - 0.5 * inner) + 0.5 * np.log(2.0 * pi * S)
        weights = np.exp(self._log_chance - np.logaddexp.reduce(self._log_chance))
        return float(weights @ (sigmas * sigmas))
