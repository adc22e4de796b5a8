"""Prediction of a loss: what the filter would state of a vehicle whose GPS failed now.

The filter's own recursion runs over the next seconds, with no noise drawn. States, process model, measurement models and noise
are the filter's. Speeds and turn rates are held and every innovation is zero, so covariances alone change. Three things are
condensed, for cost:

- what is measured about the end of a step becomes one measurement of the same information;
- a peer is a point that moves with its velocity, with the error of its reports, whose white part is averaged;
- the manoeuvre detector has the mean gain of steady flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from gcs_coloc.core.estimator import LossQuery
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    FloatArray,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.core.readiness.held_motion import HeldMotion
from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, ManoeuvreDetector, NoiseSplit, without_time_error
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster, ClusterSet
from gcs_coloc.estimators.fleet.ekf.measurement_models import air_velocity, altitude, slant_range
from gcs_coloc.estimators.fleet.ekf.process_model import fresh_air_data, set_transition
from gcs_coloc.estimators.fleet.ekf.records import Neighbour, Records, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import BARO_ERROR, VELOCITY, pair_key, whiten
from gcs_coloc.estimators.fleet.ekf.update import (
    augment_by_unknown,
    change_time_stamp_offset_sigma,
    propagate_pair,
    split_report_noise,
    time_stamp_offset_sigma_s,
)
from gcs_coloc.estimators.fleet.estimates import estimate_of_cluster, with_possible_motion
from gcs_coloc.estimators.fleet.fleet_model import UNDERSTATED, FleetModel
from gcs_coloc.estimators.fleet.initialisation import initialise_from_reports
from gcs_coloc.estimators.fleet.observed_biases import presume_bias, unknown_errors
from gcs_coloc.estimators.fleet.peer_selection import rough_position, select_peers

_BARO = slice(BARO_ERROR, BARO_ERROR + 1)
_LONGEST_STEP_S, _LAST_STEP_S = 5.0, 0.7
"""Steps are halved towards the horizon: what was measured long before it tells of what lasts alone. Chosen: nine of them, with
sigmas 1 to 4 % below those of steps of 0.25 s; ten equal ones make them 10 % too small."""
_TESTED_RANGES = 25  # the newest ranges of a pair, which tell its noise; chosen: its sigma is then known to a fifth
_STEADY_GAIN = 2.47
"""Mean of the gain of eq. (9) in steady flight: of max(r^2, 1), where 2 r is chi-square of two degrees of freedom."""
_STEADY = ManoeuvreDetector(c_e=math.sqrt(2.0 * math.sqrt(_STEADY_GAIN)), C_ee=1.0, C_nn=1.0, C_uu=1.0)


def predict_loss(model: FleetModel, query: LossQuery) -> list[Estimate | NoEstimate]:
    """Predict a healthy vehicle's estimates from a loss at this time step by step to the horizon."""
    at_s, cluster = query.at_s, _cluster_alone(model, query.vehicle, query.at_s)
    if cluster is None:
        return [model.estimate(query.vehicle, at_s)]
    prediction = _LossPrediction(model, query, cluster)
    answers = [prediction.estimate(at_s)]
    steps_s = step_lengths_s(query.horizon_s)
    prediction.use_measurements(0.5 * steps_s[0])
    passed_s = 0.0
    for step_s, next_s in zip(steps_s, (*steps_s[1:], 0.0), strict=True):
        passed_s += step_s
        prediction.propagate(at_s + passed_s - min(prediction.delay_s, 0.5 * step_s))
        # Half of what is measured in a step counts at its start, half at its end.
        prediction.use_measurements(0.5 * (step_s + next_s))
        answers.append(prediction.estimate(at_s + passed_s))
    return answers


def step_lengths_s(horizon_s: float) -> list[float]:
    """Return the steps up to a horizon, s."""
    steps_s, left_s = [], horizon_s
    while left_s > _LAST_STEP_S:
        steps_s.append(min(_LONGEST_STEP_S, 0.5 * left_s))
        left_s -= steps_s[-1]
    return [*steps_s, left_s]


def _cluster_alone(model: FleetModel, vehicle: int, at_s: float) -> Cluster | None:
    """Return a healthy vehicle alone, denied from a time on; None where nothing tells where it is."""
    known = model.records.get(vehicle)
    if known is None or known.static or known.denied_vehicle:
        return None
    records = Records()
    records.copy_from(model.records, vehicle)
    records[vehicle].denied_vehicle = True
    records[vehicle].told_at_s = at_s
    clusters, cluster = ClusterSet(model.settings, records), model.clusters.get(vehicle)
    if cluster is None:
        return clusters[vehicle] if initialise_from_reports(clusters, vehicle, at_s) else None
    joint = cluster.joint
    return clusters.initialise(vehicle, joint.mean(vehicle).copy(), joint.covariance(vehicle).copy(), joint.time_s[vehicle])


class _LossPrediction:
    """The filter of one vehicle whose loss is predicted; a range arrives `delay_s` after its measuring."""

    def __init__(self, model: FleetModel, query: LossQuery, cluster: Cluster) -> None:
        self._settings = model.settings
        self._turns_radps = query.turns_radps
        self._vehicle, self._at_s = query.vehicle, query.at_s
        self._cluster, self._records = cluster, cluster.records
        self._height_sigma_m, self._height_rate_hz = query.height_sigma_m, 0.0
        self._attitude: AttitudeMeasurement | None = None
        self._add_peers(model, query.ranges)
        self._initialise(query.horizon_s)

    def _add_peers(self, model: FleetModel, ranges: Sequence[RangeMeasurement]) -> None:
        """Add the peers that are ranged now and whose position is known: as many as the filter would select."""
        by_stream: dict[tuple[int, tuple[int, int, int]], list[RangeMeasurement]] = {}
        for m in sorted(ranges, key=lambda m: m.measured_at_s):
            node = m.other_end(self._vehicle)
            by_stream.setdefault((node, pair_key(node, self._vehicle, m.device_id)), []).append(m)
        fresh_s = self._at_s - self._settings.peer_fresh_s
        by_stream = {key: each for key, each in by_stream.items() if each[-1].measured_at_s >= fresh_s}
        placed = {
            node: place
            for node in sorted({node for node, _ in by_stream})
            if (place := rough_position(model.clusters, node)) is not None
        }
        most = self._settings.peers_per_denied_vehicle
        if len(placed) > most:
            here = np.array(self._cluster.position(self._vehicle))
            height_known = self._height_sigma_m < math.inf
            chosen = select_peers(here, list(placed.items()), frozenset(), frozenset(), most, height_known=height_known)
            placed = {node: place for node, place in placed.items() if node in chosen}
        points = {node: peer_point(model, node, self._at_s, self._turns_radps.get(node, 0.0)) for node in placed}
        self._points = {node: point for node, point in points.items() if point is not None}
        self._streams = [self._stream(node, pair, each) for (node, pair), each in by_stream.items() if node in self._points]
        delays_s = [m.arrived_at_s - m.measured_at_s for each in by_stream.values() for m in each]
        self.delay_s = max(median(delays_s), 0.0) if delays_s else 0.0

    def _initialise(self, horizon_s: float) -> None:
        """Hold what the vehicle measures of itself, and give the peers their states."""
        record, joint = self._records[self._vehicle], self._cluster.joint
        record.manoeuvre = _STEADY.copy()
        velocity_e, velocity_n, velocity_u = joint.mean(self._vehicle)[VELOCITY].tolist()
        place, turn = self._cluster.position(self._vehicle), self._turns_radps.get(self._vehicle, 0.0)
        known = HeldMotion(place, (velocity_e, velocity_n, velocity_u), turn)
        self._way = known.after(self._at_s - joint.time_s[self._vehicle])
        attitude = fresh_air_data(record, self._settings, self._at_s)
        if attitude is not None:
            # It stays fresh: attitudes go on coming. The process noise is that of level flight, to which a turn comes back.
            self._attitude = record.attitude = replace(attitude, roll_rad=0.0, measured_at_s=self._at_s + horizon_s)
        if self._height_sigma_m < math.inf:
            own = record.recent_own
            reports = sum(isinstance(m, PositionMeasurement) for m in own)
            self._height_rate_hz = reports / max(own[-1].measured_at_s - own[0].measured_at_s, 1.0) if own else 0.0
            before_m, now_m = record.baro_error_sigma_m, self._height_sigma_m
            record.baro_error_sigma_m = self._cluster.change_sigma(self._vehicle, _BARO, before_m, now_m)
        self._points = {
            node: replace(point, motion=point.motion.in_formation_with(self._way)) for node, point in self._points.items()
        }
        for node, point in self._points.items():
            self._records[node] = VehicleRecord(static=True)
            joint.augment(node, np.array(point.motion.position), point.covariance_m2, self._at_s)
        for stream in self._streams:
            if stream.stamp_sigma_s is not None:
                change_time_stamp_offset_sigma(self._cluster, self._vehicle, stream.stamp_sigma_s)

    def use_measurements(self, span_s: float) -> None:
        """Use all that is measured in a span about the time of the states."""
        self._use_attitude(span_s)
        self._use_height(span_s)
        for stream in self._streams:
            self._use_ranges(stream, span_s)

    def estimate(self, at_s: float) -> Estimate | NoEstimate:
        """Return the estimate that would be stated, or why there would be none."""
        where = estimate_of_cluster(self._cluster, self._vehicle, at_s)
        if isinstance(where, NoEstimate):
            return where
        return with_possible_motion(where, self._records[self._vehicle], self._settings)

    def _stream(self, node: int, pair: tuple[int, int, int], ranges: Sequence[RangeMeasurement]) -> RangeStream:
        sigma_m, _ = without_time_error(ranges[-1])
        noise = NO_SAMPLES
        for m in ranges[-_TESTED_RANGES:]:
            noise = noise.updated(m.measured_at_s, ((m.range_m,),), (sigma_m,))
        stamped = ranges[-1].clock_of == self._vehicle
        return RangeStream(
            node,
            pair,
            len(ranges) / max(self._at_s - ranges[0].measured_at_s, 1.0),
            sigma_m,
            noise.mean_square_m2(0),
            time_stamp_offset_sigma_s(ranges[-1], self._settings) if stamped else None,
        )

    def propagate(self, to_s: float) -> None:
        """Propagate the vehicle in one step: on a straight way none is too long for the linearisation."""
        joint, transition, where = self._cluster.joint, self._cluster.transition, self._cluster.joint.where[self._vehicle]
        record, state = self._records[self._vehicle], (joint.A[0, where].tolist(), joint.A[where, where])
        if self._streams:
            # Within the step the ranges go on.
            record.updated_at_s = max(record.updated_at_s, to_s - 1.0 / sum(stream.rate_hz for stream in self._streams))
        step_s = to_s - joint.time_s[self._vehicle]
        mean = set_transition(transition, record, self._settings, state, step_s, to_s)
        held = self._way.after(to_s - self._at_s)
        # What turns in wind is not quite on a circle over ground: the way that is held counts.
        mean = (*held.position, *held.velocity[:2], *mean[5:])
        joint.propagate(self._vehicle, mean, transition.F, transition.Q, to_s)
        decay = math.exp(-step_s / self._settings.report_error_time_s)
        for node, point in self._points.items():
            if not point.is_anchor:
                where = joint.where[node]
                joint.scale(where.start, where.stop, decay)
                joint.A[where, where] += (1.0 - decay * decay) * point.covariance_m2

    def _use_attitude(self, span_s: float) -> None:
        if self._attitude is None:
            return
        joint, s, m = self._cluster.joint, self._settings, self._attitude
        assert m.airspeed_mps is not None
        linear = air_velocity(joint, m, m.airspeed_mps, span_s, s, self._records[self._vehicle].gust_noise.level)
        linear.HA[:, 0] = 0.0
        # Gusts and sideslip average over a span that is longer than they last.
        averaged = min(s.air_noise_time_s / span_s, 1.0)
        R = [averaged * variance for variance in linear.R]
        joint.correct(whiten(linear.HA, linear.innovation_covariance(R)).W)

    def _use_height(self, span_s: float) -> None:
        if not self._height_rate_hz:
            return
        joint, sigma_m = self._cluster.joint, self._height_sigma_m
        # Nothing has shown yet how its error is spread over time: each part may be as large as the whole, eq. (16).
        white_m = sigma_m / math.sqrt(max(self._height_rate_hz * span_s, 1.0))
        height = AltitudeMeasurement(self._vehicle, self._at_s, self._at_s, 0.0, sigma_m)
        hA, _, variance_m2 = altitude(joint, height, white_m)
        hA[0] = 0.0
        joint.correct_scalar(hA, variance_m2)

    def _use_ranges(self, stream: RangeStream, span_s: float) -> None:
        s, joint, point = self._settings, self._cluster.joint, self._points[stream.node]
        at_s, count = joint.time_s[self._vehicle], stream.rate_hz * span_s
        stream.seen += count
        white_m, coloured_m = stream.noise_m(s.least_coloured_share)
        # The mean of a Gauss-Markov process over a long span has the variance 2 T / span.
        coloured_m *= math.sqrt(min(2.0 * s.range_coloured_time_s / span_s, 1.0))
        record = self._records[self._vehicle]
        presume_bias(record, stream.sigma_m, s)
        unknown = unknown_errors([(self._vehicle, stream.node, record)], stream.pair)
        augment_by_unknown(joint, unknown, at_s)
        index = propagate_pair(self._cluster, stream.pair, at_s, (s.range_bias_sigma_m, s.range_coloured_share * coloured_m))
        motion = point.motion.after(at_s - self._at_s)
        peer = RangeEnd(stream.node, joint.where[stream.node], motion.position, motion.velocity)
        clock_of = self._vehicle if stream.stamp_sigma_s is not None else None
        m = RangeMeasurement(self._vehicle, stream.node, at_s, at_s, 0.0, white_m, clock_of=clock_of)
        ends = self._cluster.range_end(self._vehicle), peer
        linear = slant_range(joint, ends, index, m, white_m * white_m / count, s.time_stamp_offset_sigma_s / math.sqrt(count))
        if linear is None:
            return
        linear.HA[0] = 0.0
        W = joint.correct_scalar(linear.HA, linear.variance_m2)
        joint.add_sensitivity(unknown, W, math.sqrt(linear.variance_m2))
        sigma_m = math.sqrt(linear.variance_m2)
        record.neighbours[stream.node] = Neighbour(at_s, linear.unit, stream.pair, sigma_m, 1.0 / stream.rate_hz)
        record.updated_at_s = at_s


@dataclass(slots=True)
class RangeStream:
    """The ranges of one device to one peer: their rate, stated sigma, and how many of them are used.

    `scatter_m2` is the mean square of what is seen to be white, None where they come too seldom to tell. `stamp_sigma_s` is the
    time-stamp offset that they state where the vehicle's clock stamps them, else None.
    """

    node: int
    pair: tuple[int, int, int]
    rate_hz: float
    sigma_m: float
    scatter_m2: float | None
    stamp_sigma_s: float | None
    seen: float = 0.0

    def noise_m(self, least_coloured_share: float) -> tuple[float, float]:
        """Return the white and the coloured sigma that the filter would have learned by now, m."""
        noise = NO_SAMPLES
        if self.scatter_m2 is not None:
            noise = NoiseSplit((), ((self.scatter_m2 * self.seen, self.seen),))
        scatter_m = noise.lower_bound_m(0)
        white_m = scatter_m if scatter_m > UNDERSTATED * self.sigma_m else self.sigma_m
        return white_m, noise.split(0, self.sigma_m, least_coloured_share)[1]


@dataclass(frozen=True, slots=True)
class PeerPoint:
    """A peer: how it moves from the beginning on, and the covariance of its position (3, 3) m^2.

    Its error is a Gauss-Markov process as that of position reports; that of an anchor lasts.
    """

    motion: HeldMotion
    covariance_m2: FloatArray
    is_anchor: bool = False


def peer_point(model: FleetModel, node: int, at_s: float, turn_radps: float) -> PeerPoint | None:
    """Return a peer as the filter knows it; None where it does not know where it is."""
    record = model.records.get(node)
    if record is None:
        return None
    last, s = record.last_position, model.settings
    if node in model.clusters or last is None or last.velocity_enu_mps is None or record.static:
        where = model.estimate(node, at_s)
        if isinstance(where, NoEstimate):
            return None
        (e, n, u), (ve, vn, vu) = where.position_enu_m.tolist(), where.velocity_enu_mps.tolist()
        return PeerPoint(HeldMotion((e, n, u), (ve, vn, vu), turn_radps), where.covariance[:3, :3], record.static)
    if record.denied_vehicle or at_s - last.measured_at_s > s.initialisation_age_s:
        return None
    reports = sum(isinstance(m, PositionMeasurement) for m in record.recent_own)
    white, coloured = split_report_noise(record, last, s)
    velocity = np.array(last.velocity_enu_mps)
    variances_m2 = [white[axis // 2] ** 2 / max(reports, 1) + coloured[axis // 2] ** 2 for axis in range(3)]
    covariance_m2 = np.diag(variances_m2) + time_stamp_offset_sigma_s(last, s) ** 2 * np.outer(velocity, velocity)
    reported = HeldMotion(last.position_enu_m, last.velocity_enu_mps, turn_radps)
    return PeerPoint(reported.after(at_s - last.measured_at_s), covariance_m2)
