"""Survey of stations: finds positions that nobody has given, by ranges of vehicles with GPS.

A position that is found is reported to the operator, with its covariance. It locates nobody until people write it into the
configuration.

    r_k = |p_k + o - s| + b + v_k

p_k where the vehicle reports itself, o the lasting error of its receiver, s the station, b the lasting error of the ranges. No
number of ranges averages o and b away: they are further unknowns of the covariance, and where two places are compared. A station
that has two places which the ranges do not tell apart, as above and beneath vehicles at one height, is not surveyed yet.

Source: Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation (2001), section 3.4 (nonlinear least
squares); P. J. Huber, Robust Statistics (1981), for the weights; J. S. Vitter, ACM Trans. Math. Software 11 (1985), algorithm R,
for the samples that are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import dist, inf, pi, sqrt
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import FloatArray, PositionMeasurement, RangeMeasurement, Vector3
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.stations.stations import MAX_STATIONS, Station, StationPosition, StationSource

_LEAST_MOVED_M = 5.0  # chosen: ranges from one place have the same errors; a vehicle that hovers adds nothing
_MOST_SAMPLES = 120
"""Of a station. Chosen: a solution takes some 7 ms, well within the fifth of a second between reviews, and the lasting errors of
ranges and receivers, not the number, bound what is known."""
_LEAST_SAMPLES = 12  # chosen: four unknowns, three samples of each
_MANY_SAMPLES = 100  # chosen: half a kilometre of a flight; who has flown so far without an answer is told why
_MORE = 1.25  # a solution is sought anew with a quarter more samples; chosen: it costs milliseconds, and fewer say little more
_REPORT_AGE_S = 1.0  # chosen: a position is carried on by its velocity no longer, as half a g for a second is 2.5 m
_CORRELATION_TIME_S = 30.0  # Source: errors of GNSS positions are correlated for half a minute to minutes
_BIAS_SIGMA_M = 1.0  # chosen: antenna delays of uncalibrated radios are some decimetres, of others a metre
_HUBER_SIGMAS = 2.0  # chosen: as in calibration
_DIRECTIONS, _STEPS = 8, 15  # chosen: a start every 45 degrees
_HEIGHTS = (-1.0, 0.0, 1.0)  # starts of the search: around the vehicles at their median range, and as far beneath and above
_SAME_PLACE_SIGMAS = 3.0  # chosen: one equal place in a hundred is held for two
_OTHER_PLACE_COST = 12.0  # chosen: a likelihood ratio of 400; a place that fits so much worse is ruled out
_MOST_SIGMA_M = 10.0  # chosen: a coarser place than that of a receiver without corrections, three times over, helps nobody
_LEAST_INFORMATION_PER_M2 = 1e-8  # so that a place that nothing holds has a covariance, too large to be told
_BETTER = 0.5  # chosen: a survey is told anew when its sigma has halved, and not at each range


class SurveyProblem(StrEnum):
    """Why a station that is ranged has no surveyed position yet, and what helps."""

    AMBIGUOUS = "its ranges fit two places, as above and beneath: range it from another height and another course"
    COARSE = "its place is known to more than 10 m only: range it from more sides, other heights, and closer"


class SurveyedPosition(NamedTuple):
    """The surveyed position of a station: ENU in the fleet's frame, in m.

    `sigma_h_m` is the 1-sigma along the worst horizontal direction, `sigma_v_m` that of the height. `ranges` is the number of
    ranges.
    """

    enu_m: Vector3
    sigma_h_m: float
    sigma_v_m: float
    ranges: int


class _Sample(NamedTuple):
    vehicle: int
    at_s: float
    position_m: Vector3
    range_m: float
    sigma_m: float
    position_sigma_m: float


@dataclass(slots=True)
class _Survey:
    samples: list[_Sample] = field(default_factory=list)
    last_m: dict[int, Vector3] = field(default_factory=dict)
    added: int = 0
    solved_at: float = _LEAST_SAMPLES / _MORE
    found: SurveyedPosition | None = None
    told_sigma_m: float = inf
    told: set[SurveyProblem] = field(default_factory=set)

    @property
    def growth(self) -> float:
        """The factor by which the samples have grown since the last solution."""
        return self.added / self.solved_at


class StationSurvey:
    """The surveys of one fleet, by the node id of the station."""

    def __init__(self) -> None:
        self._surveys: dict[int, _Survey] = {}
        self._random = np.random.default_rng(0)  # seeded: a replay finds the same

    @property
    def found(self) -> dict[int, SurveyedPosition]:
        """All stations that were found."""
        return {node: survey.found for node, survey in sorted(self._surveys.items()) if survey.found is not None}

    def add(self, measurement: RangeMeasurement, reported: PositionMeasurement) -> None:
        """Add a range to a station and the newest reported position of its vehicle, whose GPS is healthy."""
        at, node = _place_at(reported, measurement.measured_at_s), measurement.to_vehicle
        if at is None or (node not in self._surveys and len(self._surveys) >= MAX_STATIONS):
            return
        survey = self._surveys.setdefault(node, _Survey())
        last_m = survey.last_m.get(measurement.from_vehicle)
        if last_m is not None and dist(last_m, at) < _LEAST_MOVED_M:
            return
        survey.last_m[measurement.from_vehicle] = at
        sigma_p_m = max(reported.sigma_h_m, reported.sigma_v_m)
        sample = _Sample(
            measurement.from_vehicle, measurement.measured_at_s, at, measurement.range_m, measurement.sigma_m, sigma_p_m
        )
        survey.added += 1
        if len(survey.samples) < _MOST_SAMPLES:
            survey.samples.append(sample)
        elif (place := int(self._random.integers(survey.added))) < _MOST_SAMPLES:
            # Each sample of the whole flight is kept with the same probability.
            survey.samples[place] = sample

    def solve_next(self) -> tuple[int, SurveyedPosition | SurveyProblem] | None:
        """Solve for the position of the one station whose ranges have grown most since its last solution.

        It is solved for only where its ranges have grown enough.

        Returns:
            The node id of the station, and its position where it is new or known twice as well as when it was returned last.
            Where many ranges give no position, the reason instead, once. None where there is nothing to report.
        """
        node, survey = max(self._surveys.items(), key=lambda one: one[1].growth, default=(0, _Survey()))
        if survey.growth < _MORE:
            return None
        survey.solved_at = survey.added
        result = survey_position(survey.samples)
        if isinstance(result, SurveyProblem):
            survey.found = None
            if result in survey.told or survey.added < _MANY_SAMPLES:
                return None
            survey.told.add(result)
            return node, result
        survey.found = result
        sigma_m = max(result.sigma_h_m, result.sigma_v_m)
        if sigma_m > _BETTER * survey.told_sigma_m:
            return None
        survey.told_sigma_m = sigma_m
        return node, result


def survey_position(samples: list[_Sample]) -> SurveyedPosition | SurveyProblem:
    """Return the position of the station to which samples belong, or why it is not known."""
    positions = np.array([s.position_m for s in samples])
    ranges = np.array([s.range_m for s in samples])
    white_m2 = np.array([s.sigma_m**2 + s.position_sigma_m**2 for s in samples])
    centre, reach_m = positions.mean(axis=0), float(np.median(ranges))
    angles = 2.0 * pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ring = np.array([(np.cos(angle), np.sin(angle), height) for angle in angles for height in _HEIGHTS])
    costs, states = _fit(centre + reach_m * ring, positions, ranges, white_m2)
    _, left = _linearised(states[[int(np.argmin(costs))]], positions, ranges)
    # Ranges that scatter more than they state know less; the median leaves out those that are blocked.
    scatter = 1.4826 * float(np.median(np.abs(left[0]) / np.sqrt(white_m2)))
    costs, states, covariances = _with_lasting_errors(states, samples, white_m2 * max(scatter, 1.0) ** 2)
    best, P = states[int(np.argmin(costs))], covariances[int(np.argmin(costs))]
    apart = states[:, :3] - best[:3]
    is_other = np.einsum("si,ij,sj->s", apart, np.linalg.inv(P), apart) > _SAME_PLACE_SIGMAS**2
    if bool(np.any(is_other & (costs < float(costs.min()) + _OTHER_PLACE_COST * _alike(samples, white_m2)))):
        return SurveyProblem.AMBIGUOUS
    sigma_h_m, sigma_v_m = sqrt(float(np.linalg.eigvalsh(P[:2, :2])[-1])), sqrt(float(P[2, 2]))
    if max(sigma_h_m, sigma_v_m) > _MOST_SIGMA_M:
        return SurveyProblem.COARSE
    east_m, north_m, up_m = best[:3].tolist()
    return SurveyedPosition((east_m, north_m, up_m), sigma_h_m, sigma_v_m, len(samples))


def surveyed_station(station: Station, found: SurveyedPosition, frame: LocalFrame) -> Station:
    """Return a station with the position that was found."""
    lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(*found.enu_m)
    position = StationPosition(lat_deg, lon_deg, alt_msl_m, found.sigma_h_m, found.sigma_v_m)
    return replace(station, position=position, source=StationSource.SURVEYED)


def survey_notice(station: Station, found: SurveyedPosition | SurveyProblem, frame: LocalFrame, at_s: float) -> Notice:
    """Return a notice of where a station was found, or of why it was not found.

    For a station that was found it says what to write into the configuration so that the station is used.
    """
    if isinstance(found, SurveyProblem):
        return Notice(at_s, None, "info", f"{station.label} cannot be surveyed yet: {found.value}")
    at = surveyed_station(station, found, frame).position
    assert at is not None
    table = (
        f"[[station]] id = {station.station_id}, lat_deg = {at.lat_deg:.7f}, lon_deg = {at.lon_deg:.7f}, "
        f"alt_m = {at.alt_msl_m:.1f}, sigma_m = {max(at.sigma_h_m, at.sigma_v_m):.1f}"
    )
    known = f"surveyed from {found.ranges} ranges, 1-sigma {at.sigma_h_m:.1f} m, height {at.sigma_v_m:.1f} m"
    return Notice(at_s, None, "info", f"{station.label} is {known}; to use it, add to the configuration: {table}")


def _place_at(reported: PositionMeasurement, at_s: float) -> Vector3 | None:
    """Return where a vehicle was at a time near that of its report, ENU in m; None where unknown.

    The position is extrapolated by its velocity. It is unknown where the report has no velocity or is too far off in time.
    """
    t = at_s - reported.measured_at_s
    if reported.velocity_enu_mps is None or abs(t) > _REPORT_AGE_S:
        return None
    (e, n, u), (ve, vn, vu) = reported.position_enu_m, reported.velocity_enu_mps
    return e + ve * t, n + vn * t, u + vu * t


def _fit(starts: FloatArray, positions: FloatArray, ranges: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return cost (S,) and state (S, 4) at the minima near S starts: Levenberg-Marquardt, Huber's weights."""
    x = np.column_stack([starts, np.zeros(len(starts))])
    prior = np.array([0.0, 0.0, 0.0, _BIAS_SIGMA_M**-2])
    damping = np.full(len(x), 1e-3)
    H, left = _linearised(x, positions, ranges)
    cost = _cost(left, variances, x)
    diagonal = np.arange(4)
    for _ in range(_STEPS):
        weighted = (H * _weights(left, variances)[..., np.newaxis]).swapaxes(1, 2)
        N = weighted @ H
        N[:, diagonal, diagonal] += prior
        N[:, diagonal, diagonal] += damping[:, np.newaxis] * (N[:, diagonal, diagonal] + 1e-12)
        pull = (weighted @ left[..., np.newaxis])[..., 0] - prior * x
        new = x + np.linalg.solve(N, pull[..., np.newaxis])[..., 0]
        H_new, left_new = _linearised(new, positions, ranges)
        cost_new = _cost(left_new, variances, new)
        better = cost_new < cost
        x, cost = np.where(better[:, np.newaxis], new, x), np.where(better, cost_new, cost)
        H, left = np.where(better[:, np.newaxis, np.newaxis], H_new, H), np.where(better[:, np.newaxis], left_new, left)
        damping = np.where(better, damping / 5.0, damping * 10.0)
    return cost, x


def _alike(samples: list[_Sample], white_m2: FloatArray) -> float:
    """Return how many samples tell of two places what one would, as receivers' errors wander slowly.

    Of the samples within their correlation time all but two say the same again, as far as their errors are those of receivers.
    """
    factors = []
    for vehicle in {sample.vehicle for sample in samples}:
        times_s = [sample.at_s for sample in samples if sample.vehicle == vehicle]
        again = len(times_s) * 2.0 * _CORRELATION_TIME_S / max(max(times_s) - min(times_s), 1.0)
        factors.append(min(max(again, 1.0), len(times_s)))
    share = np.array([sample.position_sigma_m**2 for sample in samples]) / white_m2
    return 1.0 + float(np.median(share)) * (float(np.median(factors)) - 1.0)


def _with_lasting_errors(
    x: FloatArray, samples: list[_Sample], variances: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return costs, states and covariances of S places with the lasting errors of receivers.

    Costs are (S,), states (S, 4), covariances of the places (S, 3, 3) in m^2. The errors are further unknowns of one linear step
    from each of S states. Without them a wrong place can fit better than the right
    one by far, where receivers are off by more than the ranges scatter.
    """
    positions, ranges = np.array([s.position_m for s in samples]), np.array([s.range_m for s in samples])
    vehicles = sorted({s.vehicle for s in samples})
    owner = np.array([vehicles.index(s.vehicle) for s in samples])
    sigmas_m = [max(s.position_sigma_m for s in samples if s.vehicle == vehicle) for vehicle in vehicles]
    H, left = _linearised(x, positions, ranges)
    offsets = np.zeros((*left.shape, len(vehicles), 3))
    offsets[:, np.arange(len(samples)), owner] = -H[:, :, :3]
    A = np.concatenate([H, offsets.reshape(*left.shape, -1)], axis=2)
    information = np.array([*[_LEAST_INFORMATION_PER_M2] * 3, _BIAS_SIGMA_M**-2, *np.repeat(np.power(sigmas_m, -2.0), 3)])
    weighted = (A * _weights(left, variances)[..., np.newaxis]).swapaxes(1, 2)
    pull = (weighted @ left[..., np.newaxis])[..., 0]
    pull[:, 3] -= information[3] * x[:, 3]
    inverse = np.linalg.inv(weighted @ A + np.diag(information))
    step = (inverse @ pull[..., np.newaxis])[..., 0]
    return _cost(left, variances, x) - (pull * step).sum(axis=1), x + step[:, :4], inverse[:, :3, :3]


def _linearised(x: FloatArray, positions: FloatArray, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return H (S, N, 4) and the residuals (S, N) at S states."""
    d = x[:, np.newaxis, :3] - positions
    distances = np.maximum(np.linalg.norm(d, axis=2), 1e-6)
    H = np.concatenate([d / distances[..., np.newaxis], np.ones((*distances.shape, 1))], axis=2)
    return H, ranges - distances - x[:, 3:]


def _weights(left: FloatArray, variances: FloatArray) -> FloatArray:
    """Return Huber's weights (S, N) of residuals, 1/m^2."""
    return np.asarray(np.minimum(1.0, _HUBER_SIGMAS * np.sqrt(variances) / np.maximum(np.abs(left), 1e-9)) / variances)


def _cost(left: FloatArray, variances: FloatArray, x: FloatArray) -> FloatArray:
    """Return the cost at S states: twice Huber's loss of the residuals, and the square of the bias."""
    z = np.abs(left) / np.sqrt(variances)
    loss = np.where(z <= _HUBER_SIGMAS, z * z, 2.0 * _HUBER_SIGMAS * z - _HUBER_SIGMAS**2)
    return np.asarray(loss.sum(axis=1) + (x[:, 3] / _BIAS_SIGMA_M) ** 2)
