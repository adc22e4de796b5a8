"""The paper's flight, and runs of the filters on it over draws of noise.

The filters are the paper's and the fleet filter. The errors of the paper's filters are summed up while they run.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    FloatArray,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.study.paper_filters import KINDS, Draw, PaperFilters, draw
from gcs_coloc.study.paper_options import ConstantR, PaperOptions
from sitl_fakes.guidance import PAPER_ROUTES, EndOfRoute, fly_routes

SAMPLE_S = 0.2
"""Spacing of the series kept for figures; tables take every step."""

_LEVEL_SIGMA_M = 1.0
"""1-sigma of the height, zero, that the fleet filter gets: the paper flies in a plane. Chosen: that of a barometer."""

_FAR_M = 1e150  # chosen: its square is finite


@dataclass(frozen=True, slots=True)
class PaperFlight:
    """True motion of UAV1-4, and the waypoints of their routes.

    Times (T,) in s, positions (4, T, 2) in m, velocities (4, T, 2) in m/s.
    """

    times_s: FloatArray
    positions_m: FloatArray
    velocities_mps: FloatArray
    routes_m: tuple[FloatArray, ...]


def fly(options: PaperOptions) -> PaperFlight:
    """Fly Table 1 under the options; sample k is at k steps."""
    nominal = fly_routes(
        airspeed_mps=options.speed_mps,
        step_s=options.step_s,
        duration_s=options.duration_s,
        end_of_route=EndOfRoute(options.end_of_route),
    )
    return PaperFlight(
        times_s=nominal.times_s,
        positions_m=np.stack([nominal.east_m, nominal.north_m], axis=-1),
        velocities_mps=np.stack([nominal.ve_mps, nominal.vn_mps], axis=-1),
        routes_m=tuple(np.array(route) for route in PAPER_ROUTES),
    )


@dataclass(slots=True)
class Sums:
    """Sums over the steps of a flight by kind of filter, q and draw, shape (K, Q, S).

    They are those of steps, errors, squared errors and NEES. `largest_m` is the largest error.
    """

    count: FloatArray
    error_m: FloatArray
    squared_m2: FloatArray
    nees: FloatArray
    largest_m: FloatArray

    def add(self, distance: FloatArray, nees: FloatArray) -> None:
        """Add one step's errors, m, and NEES."""
        # A filter that has diverged beyond all numbers still has to be a number in the table.
        distance = np.nan_to_num(distance, nan=_FAR_M, posinf=_FAR_M)
        self.count += 1
        self.error_m += distance
        self.squared_m2 += distance**2
        self.nees += nees
        np.maximum(self.largest_m, distance, out=self.largest_m)


@dataclass(frozen=True, slots=True)
class FilterSeries:
    """One filter along the flight: N samples, M draws.

    `estimate_m` (N, 2), `error_m` (N,) and `sigma_m` (N,), the root of the trace of the position's covariance, are those of the
    first draw; `nees` (N,) is the mean over draws, of two degrees of freedom. NaN where there is no estimate.
    """

    times_s: FloatArray
    estimate_m: FloatArray
    error_m: FloatArray
    sigma_m: FloatArray
    nees: FloatArray


@dataclass(frozen=True, slots=True)
class Geometry:
    """The first draw's fixes at the q of the figures.

    Positions (N, 2), errors (N,) and the paper's sqrt(A11 + A22) (N,), all in m.
    """

    fix_m: FloatArray
    fix_error_m: FloatArray
    hdop_m: FloatArray


@dataclass(frozen=True, slots=True)
class PaperRun:
    """What the paper's filters gave for some draws.

    Sums over the flight and over its first part, and series by kind of filter at the q of the figures.
    """

    whole: Sums
    first: Sums
    series: dict[str, FilterSeries]
    geometry: Geometry


def constant_covariance(flight: PaperFlight, options: PaperOptions) -> FloatArray:
    """Return the general filter's R by q, shape (Q, 2, 2), m^2.

    It follows from the errors of fixes on a draw that no table uses.
    """
    pilot = draw(flight.positions_m, flight.velocities_mps, options.first_seed + options.seeds, options)
    filters = PaperFilters([pilot], np.broadcast_to(np.eye(2), (len(options.qs), 2, 2)), options)
    errors = np.stack([filters.step(k).fix_m[:, 0] - flight.positions_m[3, k] for k in range(1, len(flight.times_s))])
    errors = errors[np.isfinite(errors).all(axis=(1, 2))]
    if options.constant_r is ConstantR.VARIANCE:
        variances = errors.var(axis=0)
    else:
        # For normal errors 1.4826 times the median absolute deviation is the standard deviation.
        variances = (1.4826 * np.median(np.abs(errors - np.median(errors, axis=0)), axis=0)) ** 2
    return np.asarray(variances[..., np.newaxis] * np.eye(2))


def run_paper_filters(flight: PaperFlight, seeds: list[int], constant_R: FloatArray, options: PaperOptions) -> PaperRun:
    """Take the paper's filters through the flight for some seeds."""
    draws = [draw(flight.positions_m, flight.velocities_mps, seed, options) for seed in seeds]
    filters = PaperFilters(draws, constant_R, options)
    shape = (len(KINDS), len(options.qs), len(seeds))
    whole, first = (Sums(*np.zeros((len(fields(Sums)), *shape))) for _ in range(2))
    keep_every = max(1, round(SAMPLE_S / options.step_s))
    at_q = options.qs.index(options.figure_q)
    kept: list[tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]] = []
    fixes: list[tuple[FloatArray, float]] = []
    for k in range(1, len(flight.times_s)):
        step = filters.step(k)
        error = step.state[..., [0, 2]] - flight.positions_m[3, k]
        P = step.covariance[..., [0, 2], :][..., [0, 2]]
        distance = np.linalg.norm(error, axis=-1)
        nees = np.einsum("...i,...i->...", error, np.linalg.solve(P, error[..., np.newaxis])[..., 0])
        whole.add(distance, nees)
        if flight.times_s[k] <= options.first_part_s:
            first.add(distance, nees)
        if k % keep_every == 0:
            sigma = np.sqrt(np.trace(P[:, at_q, 0], axis1=-2, axis2=-1))
            place = step.state[:, at_q, 0][:, [0, 2]]
            kept.append((float(flight.times_s[k]), place, distance[:, at_q, 0], sigma, nees[:, at_q].mean(axis=-1)))
            published = step.published_r[at_q, 0]
            fixes.append((step.fix_m[at_q, 0], float(np.sqrt(np.trace(published)))))
    times, places, errors, sigmas, nees_means = (np.array(column) for column in zip(*kept, strict=True))
    fix = np.array([one[0] for one in fixes])
    truth = flight.positions_m[3, keep_every::keep_every][: len(fix)]
    return PaperRun(
        whole=whole,
        first=first,
        series={
            kind: FilterSeries(times, places[:, i], errors[:, i], sigmas[:, i], nees_means[:, i]) for i, kind in enumerate(KINDS)
        },
        geometry=Geometry(fix, np.linalg.norm(fix - truth, axis=-1), np.array([one[1] for one in fixes])),
    )


def run_fleet(flight: PaperFlight, seed: int, options: PaperOptions) -> FilterSeries:
    """Run the fleet filter through the flight for one seed.

    It gets the very measurements that the paper's filters get, and a height of zero.
    """
    one = draw(flight.positions_m, flight.velocities_mps, seed, options)
    estimator = load_estimator("fleet", {})
    for uav in range(4):
        estimator.add(_position(one, uav, 0, 0.0, options))
    estimator.set_denied([4], 0.0)
    keep_every = max(1, round(SAMPLE_S / options.step_s))
    rows = []
    for k in range(1, len(flight.times_s)):
        t = float(flight.times_s[k])
        estimator.add(AltitudeMeasurement(4, t, t, 0.0, _LEVEL_SIGMA_M))
        for uav in range(3):
            estimator.add(_position(one, uav, k, t, options))
            estimator.add(RangeMeasurement(4, uav + 1, t, t, max(0.0, float(one.ranges_m[uav, k])), options.range_sigma_m))
        if k % keep_every == 0:
            answer = estimator.estimate(4, t)
            if isinstance(answer, Estimate):
                error = answer.position_enu_m[:2] - flight.positions_m[3, k]
                P = answer.covariance[:2, :2]
                nees = float(error @ np.linalg.solve(P, error))
                rows.append((t, *answer.position_enu_m[:2], np.linalg.norm(error), np.sqrt(np.trace(P)), nees))
            else:
                rows.append((t, *[np.nan] * 5))
    columns = np.array(rows, dtype=np.float64).T
    return FilterSeries(columns[0], columns[1:3].T, columns[3], columns[4], columns[5])


def _position(one: Draw, uav: int, k: int, t: float, options: PaperOptions) -> PositionMeasurement:
    east, north = one.gps_m[uav, k].tolist()
    ve, vn = one.start_velocity_mps[uav].tolist()
    start = k == 0
    return PositionMeasurement(
        vehicle=uav + 1,
        measured_at_s=t,
        arrived_at_s=t,
        position_enu_m=(east, north, 0.0),
        sigma_h_m=options.gps_sigma_m,
        sigma_v_m=_LEVEL_SIGMA_M,
        velocity_enu_mps=(ve, vn, 0.0) if start else None,
        sigma_velocity_mps=options.start_speed_sigma_mps if start else None,
    )
