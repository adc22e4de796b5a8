"""What the aircraft of the paper's flight measure: clean and synchronous, with air data, or as telemetry over poor links."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from gcs_coloc.core.clocks.sender_clock import SenderClock
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
)
from sitl_fakes.guidance import PAPER_ROUTES, NominalFlight, fly_routes

GPS_SIGMA_M = 15.0
RANGE_SIGMA_M = 20.0
ASK_EVERY_S = 0.2
_STEP_S = 0.02
_AIR_DATA_EVERY_S = 0.1
_HEIGHT_EVERY_S = 0.1
# The paper flies in a plane; the estimators work in space and are told the height, which is zero, to this.
_LEVEL_SIGMA_M = 1.0
_START_SPEED_SIGMA_MPS = 1.0
_ATTITUDE_SIGMA_RAD = np.radians(1.5)
_AIRSPEED_SIGMA_MPS = 1.0
_AIRSPEED_MPS = 50.0
# The fifth aircraft of the flight with two failures: between the paper's four, which are numbered 1 to 4.
_FIFTH_ROUTE = ((5000.0, 3000.0), (9000.0, 3000.0), (9000.0, -3000.0), (3000.0, -3000.0))


@dataclass(frozen=True, slots=True)
class Links:
    """Telemetry as it arrives: delays in s, clock offsets in s, drift, share lost, share of ranges late by multipath, m."""

    min_delay_s: tuple[float, float] = (0.05, 0.2)
    jitter_s: float = 0.2
    clock_offset_s: float = 2.0
    clock_drift: float = 20e-6
    lost_share: float = 0.05
    multipath_share: float = 0.10
    multipath_m: tuple[float, float] = (5.0, 200.0)
    heard_before_s: float = 60.0


@dataclass(frozen=True, slots=True)
class Case:
    """What is measured on the paper's flight; the vehicles of `failed` lose their GPS at the start."""

    rate_hz: float = 50.0
    duration_s: float = 360.0
    wind_east_mps: float = 0.0
    air_data: bool = False
    links: Links | None = None
    failed: tuple[int, ...] = (4,)
    fifth: bool = False
    mutual: bool = True
    ask_lag_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Recording:
    """Measurements in the order of arrival; those of the start, by which the denied vehicles still have GPS, come first.

    `asked_s` (T,) are the times of the questions, `truth_m` (T, 2) per denied vehicle where it was `lag_s` before.
    """

    start: tuple[Measurement, ...]
    measurements: tuple[Measurement, ...]
    lost_at_s: float
    asked_s: FloatArray
    lag_s: float
    truth_m: dict[int, FloatArray]


@functools.lru_cache(maxsize=2)
def flown(wind_east_mps: float, fifth: bool) -> NominalFlight:
    """Return the true flight in steps of 0.02 s; kept, for it is the same for every seed."""
    routes = (*PAPER_ROUTES, _FIFTH_ROUTE) if fifth else PAPER_ROUTES
    return fly_routes(routes, airspeed_mps=_AIRSPEED_MPS, step_s=_STEP_S, wind_east_mps=wind_east_mps)


def record(case: Case, seed: int) -> Recording:
    """Return one draw of the case."""
    flight = flown(case.wind_east_mps, case.fifth)
    rng = np.random.default_rng(seed)
    places = np.stack([flight.east_m, flight.north_m], axis=-1)
    count = len(places)
    steps = np.arange(0, round(case.duration_s / _STEP_S) + 1, round(1.0 / (case.rate_hz * _STEP_S)))
    fixes = places[:, steps] + rng.normal(0.0, GPS_SIGMA_M, (count, len(steps), 2))
    velocity = np.stack([flight.ve_mps, flight.vn_mps], axis=-1)[:, 0] + rng.normal(0.0, _START_SPEED_SIGMA_MPS, (count, 2))
    start = tuple(_report(v, 0.0, fixes[v - 1, 0], velocity[v - 1]) for v in range(1, count + 1))
    rows: list[tuple[int, Measurement]] = []
    height_every, air_every = (max(1, round(every * case.rate_hz)) for every in (_HEIGHT_EVERY_S, _AIR_DATA_EVERY_S))
    for i, k in enumerate(steps.tolist()[1:], start=1):
        t = float(flight.times_s[k])
        for v in range(1, count + 1):
            if v not in case.failed:
                rows.append((v, _report(v, t, fixes[v - 1, i], None)))
            elif i % height_every == 0:
                rows.append((v, AltitudeMeasurement(v, t, t, 0.0, _LEVEL_SIGMA_M)))
            if case.air_data and i % air_every == 0:
                rows.append((v, _air_data(flight, v, k, t, rng)))
        for v in case.failed:
            for other in range(1, count + 1):
                # A pair of failed vehicles ranges once, not once from each side.
                if other == v or (other in case.failed and (not case.mutual or other < v)):
                    continue
                distance_m = float(np.hypot(*(places[v - 1, k] - places[other - 1, k])))
                rows.append((v, RangeMeasurement(v, other, t, t, _noisy(distance_m, case.links, rng), RANGE_SIGMA_M)))
    measurements = [m for _, m in rows] if case.links is None else _over(case.links, rows, count, rng)
    lag_steps = round(case.ask_lag_s / _STEP_S)
    asked = np.arange(round(1.0 / _STEP_S), steps[-1] + 1, round(ASK_EVERY_S / _STEP_S))
    return Recording(
        start=start,
        measurements=tuple(measurements),
        lost_at_s=0.0,
        asked_s=flight.times_s[asked],
        lag_s=case.ask_lag_s,
        truth_m={v: places[v - 1, asked - lag_steps] for v in case.failed},
    )


def _report(vehicle: int, t: float, fix_m: FloatArray, velocity_mps: FloatArray | None) -> PositionMeasurement:
    return PositionMeasurement(
        vehicle=vehicle,
        measured_at_s=t,
        arrived_at_s=t,
        position_enu_m=(float(fix_m[0]), float(fix_m[1]), 0.0),
        sigma_h_m=GPS_SIGMA_M,
        sigma_v_m=_LEVEL_SIGMA_M,
        velocity_enu_mps=None if velocity_mps is None else (float(velocity_mps[0]), float(velocity_mps[1]), 0.0),
        sigma_velocity_mps=None if velocity_mps is None else _START_SPEED_SIGMA_MPS,
    )


def _air_data(flight: NominalFlight, vehicle: int, k: int, t: float, rng: np.random.Generator) -> AttitudeMeasurement:
    roll, yaw = rng.normal(0.0, _ATTITUDE_SIGMA_RAD, 2)
    return AttitudeMeasurement(
        vehicle=vehicle,
        measured_at_s=t,
        arrived_at_s=t,
        roll_rad=float(flight.phi_rad[vehicle - 1, k] + roll),
        pitch_rad=0.0,
        yaw_rad=float(flight.psi_rad[vehicle - 1, k] + yaw),
        airspeed_mps=float(_AIRSPEED_MPS + rng.normal(0.0, _AIRSPEED_SIGMA_MPS)),
    )


def _noisy(distance_m: float, links: Links | None, rng: np.random.Generator) -> float:
    noisy_m = distance_m + rng.normal(0.0, RANGE_SIGMA_M)
    if links is not None and rng.random() < links.multipath_share:
        noisy_m += rng.uniform(*links.multipath_m)
    return max(0.0, noisy_m)


def _over(links: Links, rows: list[tuple[int, Measurement]], count: int, rng: np.random.Generator) -> list[Measurement]:
    """Return what arrives, in order, its stamps brought to the service's clock by the service's own means."""
    offset_s = rng.uniform(-links.clock_offset_s, links.clock_offset_s, count + 1)
    drift = 1.0 + rng.choice([-links.clock_drift, links.clock_drift], count + 1)
    least_s = rng.uniform(*links.min_delay_s, count + 1)
    clocks = [SenderClock() for _ in range(count + 1)]
    for sender, clock in enumerate(clocks):
        # The vehicles were heard before one of them lost its GPS.
        for t in np.arange(-links.heard_before_s, 0.0, 0.2):
            clock.learn(t * drift[sender] + offset_s[sender], t + least_s[sender] + rng.uniform(0.0, links.jitter_s))
    arrivals = [
        (m.measured_at_s + least_s[sender] + rng.uniform(0.0, links.jitter_s), order, sender, m)
        for order, (sender, m) in enumerate(rows)
        if rng.random() >= links.lost_share
    ]
    out: list[Measurement] = []
    for arrived_s, _, sender, m in sorted(arrivals, key=lambda row: row[:2]):
        stamp_s = m.measured_at_s * drift[sender] + offset_s[sender]
        if clocks[sender].learn(stamp_s, arrived_s):
            out.append(replace(m, measured_at_s=float(clocks[sender].to_service(stamp_s)), arrived_at_s=float(arrived_s)))
    return out
