"""What the fleet filter costs for each range, beside filterpy's EKF with the same states, Stone Soup and GTSAM."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from bench.accuracy_flights import Case, Recording, record
from bench.accuracy_peers import FilterpyEkf, installed
from bench.figures import Figure, interleaved
from gcs_coloc.core.measurements import AltitudeMeasurement, Measurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf._kernels import Transition
from gcs_coloc.estimators.fleet.ekf.state import BARO_ERROR, SIZE, TURN
from gcs_coloc.estimators.registry import load_estimator

_RATE_HZ = 5.0
_PAIR_STATES = 2
_DENSITY_M2PS3, _CLIMB_M2PS3 = 0.3, 0.02
_SLOW_TIME_S, _SLOW_SIGMA = 100.0, 1.0


class SameStatesEkf:
    """filterpy's ExtendedKalmanFilter with the fleet filter's states in one vector: 16 a vehicle and 2 a pair, all dense.

    It takes the same measurements, each at its own time; what the fleet filter does besides is left out.
    """

    def __init__(self, start: list[PositionMeasurement], denied_vehicle: int) -> None:
        self._index = {m.vehicle: i * SIZE for i, m in enumerate(start)}
        peers = [m.vehicle for m in start if m.vehicle != denied_vehicle]
        n = len(start) * SIZE + len(peers) * _PAIR_STATES
        self._pairs = {peer: len(start) * SIZE + i * _PAIR_STATES for i, peer in enumerate(peers)}
        self._filter = ExtendedKalmanFilter(dim_x=n, dim_z=1)
        self._filter.x, self._filter.P = np.zeros(n), np.eye(n)
        self._at_s = start[0].measured_at_s
        self._denied_vehicle = denied_vehicle
        self._step = Transition()
        for m in start:
            self._filter.x[self._index[m.vehicle] : self._index[m.vehicle] + 3] = m.position_enu_m

    def add(self, m: Measurement) -> None:
        """Predict all states to the measurement's time, and correct with it."""
        if m.measured_at_s > self._at_s:
            self._predict(m.measured_at_s - self._at_s)
            self._at_s = m.measured_at_s
        if isinstance(m, PositionMeasurement) and m.vehicle in self._index:
            self._position(m)
        elif isinstance(m, AltitudeMeasurement) and m.vehicle in self._index:
            self._altitude(m)
        elif isinstance(m, RangeMeasurement):
            self._range(m)

    def _predict(self, step_s: float) -> None:
        n = len(self._filter.x)
        F, Q = np.eye(n), np.zeros((n, n))
        slow = math.exp(-step_s / _SLOW_TIME_S)
        for i in self._index.values():
            block = slice(i, i + SIZE)
            self._step.set_motion(self._filter.x[block].tolist(), step_s, float(self._filter.x[i + TURN]), in_wind=False)
            self._step.set_acceleration_noise(step_s, _DENSITY_M2PS3, _CLIMB_M2PS3)
            F[block, block], Q[block, block] = self._step.F, self._step.Q
        for k in (*(i + s for i in self._index.values() for s in range(6, SIZE)), *range(len(self._index) * SIZE, n)):
            F[k, k] = slow
            Q[k, k] = _SLOW_SIGMA**2 * (1.0 - slow * slow)
        self._filter.F, self._filter.Q = F, Q
        self._filter.predict()

    def _position(self, m: PositionMeasurement) -> None:
        i = self._index[m.vehicle]
        k = 3 if m.velocity_enu_mps is None else 6
        H = np.zeros((k, len(self._filter.x)))
        H[np.arange(k), i + np.arange(k)] = 1.0
        H[np.arange(3), i + 11 + np.arange(3)] = 1.0
        z = np.array([*m.position_enu_m, *(m.velocity_enu_mps or ())])
        self._filter.update(z, lambda _: H, lambda x: H @ x, R=np.eye(k) * m.sigma_h_m**2)

    def _altitude(self, m: AltitudeMeasurement) -> None:
        i = self._index[m.vehicle]
        H = np.zeros((1, len(self._filter.x)))
        H[0, [i + 2, i + BARO_ERROR]] = 1.0
        self._filter.update(np.array([m.up_m]), lambda _: H, lambda x: H @ x, R=np.array([[m.sigma_m**2]]))

    def _range(self, m: RangeMeasurement) -> None:
        a, b, pair = self._index[m.from_vehicle], self._index[m.to_vehicle], self._pairs[m.to_vehicle]
        away = self._filter.x[a : a + 3] - self._filter.x[b : b + 3]
        distance = float(np.linalg.norm(away))
        H = np.zeros((1, len(self._filter.x)))
        H[0, a : a + 3], H[0, b : b + 3] = away / distance, -away / distance
        H[0, pair : pair + 2] = 1.0
        self._filter.update(
            np.array([m.range_m]),
            lambda _: H,
            lambda x: np.array([distance + x[pair] + x[pair + 1]]),
            R=np.array([[m.sigma_m**2]]),
        )


def measure(quick: bool) -> list[Figure]:
    """The paper's flight of four at 5 Hz; everything that each filter does for the flight, divided by the ranges."""
    flight = record(Case(rate_hz=_RATE_HZ), 1)
    cut = flight.measurements[: len(flight.measurements) // (8 if quick else 2)]
    makers: dict[str, Callable[[], float]] = {
        "fleet": lambda: _cost_us(flight, cut, load_estimator("fleet", {})),
        "filterpy EKF, same states": lambda: _same_states_us(flight, cut),
        "filterpy EKF, 4 states of the denied vehicle alone": lambda: _cost_us(flight, cut, FilterpyEkf()),
    }
    if installed("stonesoup"):
        from bench.accuracy_stonesoup import StoneSoupEkf

        makers["Stone Soup EKF, 4 states"] = lambda: _cost_us(flight, cut, StoneSoupEkf())
    if installed("gtsam"):
        from bench.accuracy_gtsam import GtsamSmoother

        makers["GTSAM fixed-lag smoother, 4 states"] = lambda: _cost_us(flight, cut, GtsamSmoother())
    cost_us = interleaved(makers, 3)
    own = cost_us.pop("fleet")
    goals = {name: name.startswith(("filterpy EKF, same", "Stone", "GTSAM")) for name in cost_us}
    return [
        Figure("fleet filter, CPU for each range, reports of the peers and questions included", f"{own:.0f} us"),
        *(
            Figure(
                f"beside {name}",
                f"{cost:.0f} us: {cost / own:.2f} times ours",
                "> 1" if goals[name] else "",
                cost > own if goals[name] else None,
            )
            for name, cost in cost_us.items()
        ),
        *(Figure(f"beside {name}", "not installed", "> 1") for name in ("stonesoup", "gtsam") if not installed(name)),
    ]


def _cost_us(flight: Recording, cut: Sequence[Measurement], estimator) -> float:  # type: ignore[no-untyped-def]
    (denied_vehicle,) = flight.truth_m
    for m in flight.start:
        estimator.add(m)
    estimator.set_denied([denied_vehicle], flight.lost_at_s)
    began_s, asked_s = time.process_time(), cut[0].arrived_at_s
    for m in cut:
        if m.arrived_at_s > asked_s:
            estimator.estimate(denied_vehicle, asked_s)
            asked_s = m.arrived_at_s
        estimator.add(m)
    estimator.estimate(denied_vehicle, asked_s)
    return _per_range(time.process_time() - began_s, cut)


def _same_states_us(flight: Recording, cut: Sequence[Measurement]) -> float:
    (denied_vehicle,) = flight.truth_m
    last = {m.vehicle: m for m in flight.start if isinstance(m, PositionMeasurement)}
    ekf = SameStatesEkf(list(last.values()), denied_vehicle)
    began_s = time.process_time()
    for m in cut:
        ekf.add(m)
    return _per_range(time.process_time() - began_s, cut)


def _per_range(spent_s: float, cut: Sequence[Measurement]) -> float:
    return spent_s / sum(isinstance(m, RangeMeasurement) for m in cut) * 1e6
