"""Fault filters of one denied vehicle: which peer is faulty, and how far is the vehicle displaced?

They are multiple-model filters (MMAE).

One Kalman filter per hypothesis: nobody is faulty, each peer is, the vehicle's own ranging device is. State of each filter:
- the vehicle's displacement from its estimate, east and north (m), a random walk;
- for each peer the fault-free error of its position along the line of sight (m), a Gauss-Markov process;
- the fault: its size along the line of sight (m) and its rate (m/s).
Measurement of peer k: z = u_k . displacement + error_k + size if k is faulty, else without size; u_k is the unit vector from it.
For the own device the size is in the measurements of all peers.

Probabilities follow Bayes' rule: p_j is proportional to p_j N(innovation_j; 0, S_j). A fault may begin at any time. Therefore
each fault's filter is mixed in every step with the filter without fault, by the probability that the fault began in that step:
mean and covariance are those of the Gaussian mixture. So a slow drift is tested since its beginning, against the drift of
fault-free errors.

The vehicle's own motion is nearly unused: its displacement may change by metres in a step, so that the result does not depend on
the estimator's model of the motion.

Source: D. T. Magill, IEEE Trans. AC 10 (1965), MMAE; H. A. P. Blom and Y. Bar-Shalom, IEEE Trans. AC 33 (1988), mixing; A. S.
Willsky and H. L. Jones, IEEE Trans. AC 21 (1976), faults that begin at an unknown time; P. J. Huber (1964), bounded influence.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import exp, hypot, inf, log, pi, sqrt

import numpy as np

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius
from gcs_coloc.core.measurements import FloatArray

_UNKNOWN_M2 = 1e4  # 1-sigma of 100 m; chosen: far beyond any displacement that ranges allow
_LOG_ZERO = -700.0  # log of a probability of zero; exp of less underflows at -745
_SIZE, _RATE = -2, -1
_MAX_EXTRAPOLATION = 3.0  # chosen: a fault's effect is at most trebled since the last ranges

# The stochastic model of faults, fault-free errors and ranges.
_CORRELATION_TIME_S = 30.0
"""Of a fault-free position error, s. Source: errors of GNSS positions are correlated for half a minute to minutes."""
_ONSET_RATE_PER_S = 1.0 / 600.0
"""Rate at which a peer's fault begins, 1/s. Chosen: one in ten minutes, far oftener than in truth: it is looked for."""
_END_RATE_PER_S = 1.0 / 3600.0  # rate at which a fault ends, 1/s; chosen: it lasts for an hour; what ended is found by its ranges
_ONSET_SIGMA_M = 1.0
"""1-sigma of a beginning fault's size along the line of sight, m. Chosen: a ramp begins small; a step is found at once."""
_ONSET_RATE_SIGMA_MPS = 1.5
"""1-sigma of a beginning fault's rate along the line of sight, m/s. Chosen: spoofers draw off at 0.2 to 5 m/s."""
_RATE_DENSITY_M2PS3 = 0.1
"""Power spectral density of the change of that rate, m²/s³. Chosen: it changes by 1 m/s within ten seconds."""
_DISPLACEMENT_DENSITY_M2PS = 4.0
"""That of the vehicle's displacement by a fault, m²/s. Chosen: 2 m in a second, as fast as ranges carry an estimate off."""
_RESET_AFTER = 3
"""A filter that does not explain so many residuals in a row of more than half of the peers takes its displacement for unknown
again. Chosen: one or two are outliers. A step may have the residuals of a few peers only."""
_HUBER_SIGMA = 1.5  # from so many sigmas on an innovation has bounded influence. Source: Huber's usual constant, 1.345 to 1.5
_GATE_SIGMA = 3.0  # from so many sigmas on it has none; chosen: one in 370 Gaussian ones
_NOISE_TIME_S = 15.0  # averaging time of the inflation of the measurement noise, s; chosen: half of `_CORRELATION_TIME_S`
_MAX_STEP_S = 3.0  # a peer without ranges for longer leaves the filters, s; chosen: three windows of residuals


@dataclass(frozen=True, slots=True)
class LineOfSightResidual:
    """The range residual to one peer in one step.

    `residual_m`: observed minus computed range, m, `noise_m` its 1-sigma. `position_sigma_m`: 1-sigma of the fault-free errors of
    both ends along the line of sight, m. `unit`: its horizontal direction (east, north), from the peer.
    """

    residual_m: float
    noise_m: float
    position_sigma_m: float
    unit: tuple[float, float]


@dataclass(frozen=True, slots=True)
class FaultHypothesis:
    """One fault hypothesis: its probability, and how far the fault displaces the denied vehicle.

    `faulty` is the faulty vehicle, None for the denied vehicle's own ranging device. `separation_m2` is the second moment of
    the displacement if the hypothesis is true: the east, east-north and north element, m^2, of the solution separation. That is
    this filter's displacement minus that of the filter without fault.
    """

    faulty: int | None
    probability: float
    separation_m2: tuple[float, float, float]


@dataclass(slots=True)
class _Peer:
    """What the filters know of one peer beside their states; `noise` inflates its measurement noise."""

    updated_s: float
    position_sigma_m: float
    noise: float = 1.0


class FaultFilters:
    """The fault filters of one denied vehicle. Order: nobody faulty, each of `peers`, its own device."""

    def __init__(self) -> None:
        self.at_s = float("-inf")
        self.peers: list[int] = []
        self._known: dict[int, _Peer] = {}
        self._clear(0)

    def _clear(self, peers: int) -> None:
        models, size = peers + 2, peers + 4
        # Row 0 of each filter is its mean, the rows below are its covariance: one product predicts or corrects both.
        self._A: FloatArray = np.zeros((models, 1 + size, size))
        self._covariances[:, [0, 1], [0, 1]] = _UNKNOWN_M2
        self._log_probability = [0.0] + [_LOG_ZERO] * (models - 1)
        self._unexplained = np.zeros((models, peers), dtype=int)  # residuals in a row that a filter did not explain

    @property
    def _means(self) -> FloatArray:
        return self._A[:, 0]

    @property
    def _covariances(self) -> FloatArray:
        return self._A[:, 1:]

    def update(self, residuals: Mapping[int, LineOfSightResidual], at_s: float) -> None:
        """Update with the residuals of one step, by peer. Times increase from call to call."""
        for peer, residual in residuals.items():
            known = self._known.setdefault(peer, _Peer(at_s, 0.0))
            known.updated_s, known.position_sigma_m = at_s, residual.position_sigma_m
        peers = sorted(self.staying(at_s))
        if peers != self.peers:
            self._regroup(peers)
        step_s = min(at_s - self.at_s, _MAX_STEP_S)
        self.at_s = at_s
        self._predict(step_s)
        self._mix(step_s)
        H, z = self._design(residuals), [residual.residual_m for residual in residuals.values()]
        r = [residual.noise_m**2 * max(self._known[peer].noise, 1.0) for peer, residual in residuals.items()]
        self._reset_diverged([self.peers.index(peer) for peer in residuals], H, z, r)
        gain = 1.0 - exp(-step_s / _NOISE_TIME_S)
        for k, peer in enumerate(residuals):
            self._known[peer].noise *= 1.0 - gain + gain * self._correct(H[:, k], z[k], r[k])
        self._log_probability = _normalise(self._log_probability)

    def staying(self, at_s: float) -> list[int]:
        """Return the peers whose ranges are recent enough that they stay in the filters at a time."""
        return [p for p, known in self._known.items() if at_s - known.updated_s <= _MAX_STEP_S]

    def retain(self, peers: Collection[int]) -> None:
        """Let all other peers leave the filters with the next update."""
        for peer in self._known.keys() - set(peers):
            self._known[peer].updated_s = -inf

    def exclude(self, excluded: Collection[int]) -> None:
        """Remove excluded peers, and continue from the filter of the likeliest of them."""
        known = [p for p in self.peers if p in excluded]
        if not known:
            return
        best = max((1 + self.peers.index(p) for p in known), key=self._log_probability.__getitem__)
        A = self._A[best].copy()
        A[_SIZE:] = A[:, _SIZE:] = 0.0
        self._A[:] = A
        self._log_probability = [0.0] + [_LOG_ZERO] * (len(self._A) - 1)
        self._regroup([p for p in self.peers if p not in excluded])

    def probabilities(self) -> list[tuple[int | None, float]]:
        """Return the probability of each fault, by vehicle; None for the vehicle's own ranging device."""
        return list(zip([*self.peers, None], map(exp, self._log_probability[1:]), strict=True))

    def hypotheses(self, now_s: float, known: Collection[int] = ()) -> list[FaultHypothesis]:
        """Return all hypotheses with a fault; a growing fault is extrapolated from the last step to now.

        Where ranges to a vehicle are `known` to be off, the filter without fault believes what the estimator may have refused.
        There the displacement counts from the estimate.
        """
        out = []
        (east, north), *means = self._means[:, :2].tolist()
        faults = self._means[1:, _SIZE:].tolist()
        growth = (self._covariances[1:, :2, :2] - self._covariances[0, :2, :2]).tolist()
        for (faulty, probability), (e, n), (size_m, rate_mps), ((ee, en), (_, nn)) in zip(
            self.probabilities(), means, faults, growth, strict=True
        ):
            grown = rate_mps * (now_s - self.at_s) / size_m if size_m != 0.0 else 0.0
            ahead = min(max(1.0 + grown, 1.0), _MAX_EXTRAPOLATION)
            if faulty not in known:
                e, n = e - east, n - north
            e, n = e * ahead, n * ahead
            ee, en, nn = positive_part(ee, en, nn)
            out.append(FaultHypothesis(faulty, probability, (ee + e * e, en + e * n, nn + n * n)))
        return out

    def _regroup(self, peers: list[int]) -> None:
        """Change the peers; of those that remain states and probabilities are kept, of others nothing."""
        old, x, P, log_probability = self.peers, self._means, self._covariances, self._log_probability
        self.peers = peers
        self._known = {p: known for p, known in self._known.items() if p in peers}
        self._clear(len(peers))
        stay = [p for p in peers if p in old]
        models = [[0, *(1 + group.index(p) for p in stay), len(group) + 1] for group in (peers, old)]
        states = [[0, 1, *(2 + group.index(p) for p in stay), len(group) + 2, len(group) + 3] for group in (peers, old)]
        self._means[np.ix_(models[0], states[0])] = x[np.ix_(models[1], states[1])]
        self._covariances[np.ix_(models[0], states[0], states[0])] = P[np.ix_(models[1], states[1], states[1])]
        for model, was in zip(*models, strict=True):
            self._log_probability[model] = log_probability[was]
        for k, p in enumerate(peers):
            if p not in old:
                self._covariances[:, 2 + k, 2 + k] = self._known[p].position_sigma_m ** 2
                self._A[1 + k] = self._A[0]
        self._log_probability = _normalise(self._log_probability)

    def _predict(self, step_s: float) -> None:
        A = self._A
        models, _, size = A.shape
        correlation = exp(-step_s / _CORRELATION_TIME_S)
        transition = [1.0, 1.0, *[correlation] * len(self.peers), 1.0, 1.0]
        A *= np.outer([1.0, *transition], transition)
        A[:, :, _SIZE] += step_s * A[:, :, _RATE]
        A[:, _SIZE] += step_s * A[:, _RATE]
        displacement_m2, fresh = _DISPLACEMENT_DENSITY_M2PS * step_s, 1.0 - correlation * correlation
        errors_m2 = [self._known[p].position_sigma_m ** 2 * fresh for p in self.peers]
        variances = A.reshape(models, -1)[:, size :: size + 1]
        variances += [displacement_m2, displacement_m2, *errors_m2, 0.0, 0.0]
        variances[1:, _RATE] += _RATE_DENSITY_M2PS3 * step_s

    def _mix(self, step_s: float) -> None:
        """Mix each fault's filter with the one without fault, as a fault may begin or end in this step."""
        smallest = exp(_LOG_ZERO)
        no_fault, *faults = map(exp, self._log_probability)
        # One of them begins: all onsets together are no more than there is.
        onset = no_fault * (1.0 - exp(-_ONSET_RATE_PER_S * step_s * len(faults))) / len(faults)
        continuing = [probability * exp(-_END_RATE_PER_S * step_s) for probability in faults]
        fresh = self._A[0].copy()
        fresh[_SIZE, _SIZE], fresh[_RATE, _RATE] = _ONSET_SIGMA_M**2, _ONSET_RATE_SIGMA_MPS**2
        share = np.array([onset / max(onset + probability, smallest) for probability in continuing])[:, np.newaxis, np.newaxis]
        merged = self._A[1:]
        off = fresh - merged
        apart = off[:, :1]
        merged += share * off
        merged[:, 1:] += share * (1.0 - share) * apart * apart.transpose(0, 2, 1)
        no_fault += sum(faults) - sum(continuing) - onset * len(faults)
        self._log_probability = [
            log(max(probability, smallest)) for probability in (no_fault, *(probability + onset for probability in continuing))
        ]

    def _design(self, residuals: Mapping[int, LineOfSightResidual]) -> FloatArray:
        """Return the measurement matrices H (models, residuals, states)."""
        models, size = self._means.shape
        H: FloatArray = np.zeros((models, len(residuals), size))
        for k, (peer, residual) in enumerate(residuals.items()):
            index = self.peers.index(peer)
            H[:, k, :2] = residual.unit
            H[:, k, 2 + index] = 1.0
            H[1 + index, k, _SIZE] = 1.0
        H[-1, :, _SIZE] = 1.0
        return H

    def _reset_diverged(self, peers: list[int], H: FloatArray, z: list[float], r: list[float]) -> None:
        """Reset the displacement of filters that explain too little.

        They do not explain several residuals in a row of more than half of the peers. `peers` are by index.
        """
        columns = H.transpose(0, 2, 1)
        predicted = self._A @ columns
        variance = (columns * predicted[:, 1:]).sum(axis=1) + r
        beyond = (z - predicted[:, 0]) ** 2 > _GATE_SIGMA**2 * variance
        self._unexplained[:, peers] = np.where(beyond, self._unexplained[:, peers] + 1, 0)
        diverged = 2 * (self._unexplained >= _RESET_AFTER).sum(axis=1) > len(self.peers)
        for m in np.flatnonzero(diverged).tolist():
            self._unexplained[m] = 0
            self._covariances[m, :2] = self._covariances[m, :, :2] = 0.0
            self._covariances[m, [0, 1], [0, 1]] = _UNKNOWN_M2

    def _correct(self, h: FloatArray, z: float, r: float) -> float:
        """Correct all filters with one residual, and update their probabilities.

        Return the mean normalised innovation squared of the filters, weighted with their probabilities.
        """
        log_probability = self._log_probability
        Ah = self._A @ h[:, :, np.newaxis]
        Ph = Ah[:, np.newaxis, 1:, 0]
        predicted_m, predicted_m2 = Ah[:, 0, 0].tolist(), (Ph @ h[:, :, np.newaxis])[:, 0, 0].tolist()
        weights, squares = [], []
        for m in range(len(log_probability)):
            variance = max(predicted_m2[m], 0.0) + r
            sigmas = min(abs(z - predicted_m[m]) / sqrt(variance), _GATE_SIGMA)
            inner = min(sigmas, _HUBER_SIGMA)
            # Huber's weight, zero beyond the gate.
            weights.append(_HUBER_SIGMA / max(sigmas, _HUBER_SIGMA) / variance if sigmas < _GATE_SIGMA else 0.0)
            squares.append(sigmas * sigmas)
            log_probability[m] -= inner * (sigmas - 0.5 * inner) + 0.5 * log(2.0 * pi * variance)
        Ah[:, 0] -= z
        self._A -= Ah * (np.array(weights)[:, np.newaxis, np.newaxis] * Ph)
        return sum(
            [exp(probability) * square for probability, square in zip(_normalise(log_probability), squares, strict=True)],
            start=0.0,
        )


def _normalise(log_probability: list[float]) -> list[float]:
    """Return the logarithms of probabilities, normalised to a sum of 1 (log-sum-exp)."""
    largest = max(log_probability)
    total = largest + log(sum(exp(one - largest) for one in log_probability))
    return [one - total for one in log_probability]


def positive_part(ee: float, en: float, nn: float) -> tuple[float, float, float]:
    """Return a symmetric (2, 2) matrix with its negative eigenvalues set to zero."""
    mean, radius = eigenvalue_mean_and_radius(ee, en, nn, hypot)
    if mean >= radius:
        return ee, en, nn
    if mean <= -radius:
        return 0.0, 0.0, 0.0
    smaller, part = mean - radius, (mean + radius) / (2.0 * radius)
    return part * (ee - smaller), part * en, part * (nn - smaller)
