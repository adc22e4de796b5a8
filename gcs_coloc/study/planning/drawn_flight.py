"""Drawn flights of a plan: the fleet filter as the service runs it, with measurements at their rates and with noise.

The planned way is swayed by gusts; receivers, barometers and air data have errors that last, reported velocities too; stations
stand beside their stated places, and time stamps are off. All sizes are those that the filter's settings and the plan's
assumptions name, so what is tested is the prediction and not the settings.
"""

from __future__ import annotations

from math import atan2, exp, hypot, sqrt

import numpy as np

from gcs_coloc.core.integrity.protection_level import VERTICAL_RATIO
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    FloatArray,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.measurement_models import REPORT_VELOCITY_TIME_S
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.planning.fleet_plan import FleetPlan

SAMPLE_S = 2.0
"""Errors are taken so often."""
_WITH_GPS_S = 5.0
_STEP_S = 0.2
"""Step of the drawn flight. Chosen: reports and ranges five times a second."""
_SWAY_RADPS = 0.2
"""An autopilot corrects what a gust displaces within some seconds. Chosen: critically damped, 5 s."""
_LEAST_COLOURED_SHARE = 0.1
_VELOCITY_ERROR_TIME_S = 0.5 * REPORT_VELOCITY_TIME_S
"""A Gauss-Markov error of this correlation time has the spectral density that the filter assumes of reported velocities."""


def draw_errors(plan: FleetPlan, sysid: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Fly a plan once with one vehicle denied; return times (N,) s and horizontal errors (N,) m, NaN without an estimate."""
    return _DrawnFlight(plan, sysid, seed).run()


class _DrawnFlight:
    def __init__(self, plan: FleetPlan, sysid: int, seed: int) -> None:
        self._plan, self._denied = plan, sysid
        self._rng = np.random.default_rng([seed, sysid])
        self._settings = s = FleetSettings()
        self._filter = FleetFilter(s)
        begin_s, end_s = plan.span_s
        self._times = np.arange(begin_s, end_s, _STEP_S)
        a = plan.assumptions
        coloured_m = a.position_sigma_m * max(sqrt(1.0 - a.position_white_share**2), _LEAST_COLOURED_SHARE)
        self._way = {v: path.at(self._times) for v, path in plan.paths.items()}
        self._sway: dict[int, FloatArray] = {}
        self._report_error: dict[int, FloatArray] = {}
        self._velocity_error: dict[int, FloatArray] = {}
        self._stamp_error_s: dict[int, FloatArray] = {}
        for v in plan.paths:
            self._sway[v] = self._draw_sway(s.acceleration_density_m2ps3)
            self._report_error[v] = self._gauss_markov(coloured_m, s.report_error_time_s, 3) * (1.0, 1.0, VERTICAL_RATIO)
            self._velocity_error[v] = self._gauss_markov(a.velocity_sigma_mps, _VELOCITY_ERROR_TIME_S, 3)
            self._stamp_error_s[v] = self._gauss_markov(s.time_stamp_offset_sigma_s, s.time_stamp_offset_time_s, 1)[:, 0]
        self._stations = {
            station.node: np.array(station.position_enu_m) + station.sigma_m * self._rng.standard_normal(3)
            for station in plan.stations
        }
        self._height_error = self._gauss_markov(a.height_sigma_m, s.baro_error_time_s, 1)[:, 0]
        self._air_error = self._gauss_markov(s.air_noise_mps, s.air_noise_time_s, 2)
        self._heading_error_rad = s.heading_sigma_rad * self._rng.standard_normal()
        self._airspeed_error_mps = s.airspeed_sigma_mps * self._rng.standard_normal()

    def run(self) -> tuple[FloatArray, FloatArray]:
        plan, path = self._plan, self._plan.paths[self._denied]
        for vehicle in plan.vehicles:
            self._filter.add(VehicleClassReport(vehicle.sysid, self._times[0], self._times[0], vehicle.vehicle_class))
        for station in plan.stations:
            t, place, sigma_m = self._times[0], station.position_enu_m, station.sigma_m
            self._filter.add(PositionMeasurement(station.node, t, t, place, sigma_m, sigma_m, static=True))
        sampled_s, errors_m, is_denied = [], [], False
        every = round(SAMPLE_S / _STEP_S)
        for k, at_s in enumerate(self._times.tolist()):
            if not path.is_flying(at_s):
                continue
            if not is_denied and at_s >= path.begin_s + _WITH_GPS_S:
                self._filter.set_denied([self._denied], at_s)
                is_denied = True
            for measurement in self._measure(k, at_s):
                self._filter.add(measurement)
            if is_denied and k % every == 0:
                sampled_s.append(at_s)
                errors_m.append(self._error_m(k, at_s))
        return np.array(sampled_s), np.array(errors_m)

    def _measure(self, k: int, at_s: float) -> list[Measurement]:
        rng, a, plan = self._rng, self._plan.assumptions, self._plan
        found: list[Measurement] = []
        here = {v: self._true(v, k) for v, path in plan.paths.items() if path.is_flying(at_s)}
        for v, (place, velocity) in here.items():
            if v != self._denied or at_s < plan.paths[v].begin_s + _WITH_GPS_S:
                found.append(self._report(v, k, at_s, place, velocity))
        place, velocity = here[self._denied]
        found.append(AltitudeMeasurement(self._denied, at_s, at_s, float(place[2] + self._height_error[k]), a.height_sigma_m))
        if a.has_air_data and plan.vehicle(self._denied).vehicle_class is VehicleClass.PLANE:
            found.append(self._attitude(k, at_s, velocity))
        ends = {v: where for v, where in here.items() if v != self._denied}
        ends |= {node: (where, np.zeros(3)) for node, where in self._stations.items()}
        # The flight's step is a fifth of a second; other rates become noise of the same information.
        sigma_m = a.range_sigma_m / sqrt(a.range_rate_hz * _STEP_S)
        stamp_sigma_s = self._settings.time_stamp_offset_sigma_s
        for node, (there, its_velocity) in ends.items():
            apart = place - there
            true_m = float(np.linalg.norm(apart))
            if true_m <= a.max_range_m:
                closing_mps = float(apart @ (velocity - its_velocity)) / max(true_m, 1.0)
                error_m = sigma_m * rng.standard_normal() + closing_mps * stamp_sigma_s * rng.standard_normal()
                range_m = max(true_m + float(error_m), 0.0)
                found.append(RangeMeasurement(self._denied, node, at_s, at_s, range_m, sigma_m))
        return found

    def _report(self, v: int, k: int, at_s: float, place: FloatArray, velocity: FloatArray) -> PositionMeasurement:
        a, rng = self._plan.assumptions, self._rng
        white_m = a.position_sigma_m * a.position_white_share / sqrt(max(a.position_rate_hz * _STEP_S, 1.0))
        coloured_m = self._report_error[v]
        sigma_m = hypot(white_m, a.position_sigma_m * max(sqrt(1.0 - a.position_white_share**2), _LEAST_COLOURED_SHARE))
        late = self._stamp_error_s[v][k] * velocity
        e, n, u = (place + late + coloured_m[k] + white_m * rng.standard_normal(3) * (1.0, 1.0, VERTICAL_RATIO)).tolist()
        ve, vn, vu = (velocity + self._velocity_error[v][k]).tolist()
        vertical_m = VERTICAL_RATIO * sigma_m
        return PositionMeasurement(v, at_s, at_s, (e, n, u), sigma_m, vertical_m, (ve, vn, vu), a.velocity_sigma_mps)

    def _attitude(self, k: int, at_s: float, velocity: FloatArray) -> AttitudeMeasurement:
        ve, vn = (velocity[:2] + self._air_error[k]).tolist()
        heading_rad = atan2(ve, vn) + self._heading_error_rad
        bank_rad = self._way[self._denied].bank_rad.item(k) + 0.015 * float(self._rng.standard_normal())
        airspeed_mps = max(hypot(ve, vn) + self._airspeed_error_mps, 0.0)
        return AttitudeMeasurement(self._denied, at_s, at_s, bank_rad, 0.0, heading_rad, airspeed_mps)

    def _true(self, v: int, k: int) -> tuple[FloatArray, FloatArray]:
        moved = np.zeros((2, 3))
        moved[:, :2] = self._sway[v][k].reshape(2, 2)
        return self._way[v].positions_m[k] + moved[0], self._way[v].velocities_mps[k] + moved[1]

    def _error_m(self, k: int, at_s: float) -> float:
        where = self._filter.estimate(self._denied, at_s)
        if not isinstance(where, Estimate):
            return float("nan")
        true_m, _ = self._true(self._denied, k)
        return float(np.linalg.norm(where.position_enu_m[:2] - true_m[:2]))

    def _gauss_markov(self, sigma: float, time_s: float, axes: int) -> FloatArray:
        decay = exp(-_STEP_S / time_s)
        draws = self._rng.standard_normal((len(self._times), axes)) * sigma * sqrt(1.0 - decay * decay)
        draws[0] = sigma * self._rng.standard_normal(axes)
        for k in range(1, len(draws)):
            draws[k] += decay * draws[k - 1]
        return np.asarray(draws)

    def _draw_sway(self, density_m2ps3: float) -> FloatArray:
        """Draw sway (N, 4): east, north in m, then m/s; white acceleration on a damped oscillator."""
        rows, state = np.zeros((len(self._times), 4)), np.zeros(4)
        pushes = self._rng.standard_normal((len(rows), 2)) * sqrt(density_m2ps3 * _STEP_S)
        for k in range(1, len(rows)):
            place, speed = state[:2], state[2:]
            speed = speed + (-2.0 * _SWAY_RADPS * speed - _SWAY_RADPS**2 * place) * _STEP_S + pushes[k]
            state = np.concatenate([place + speed * _STEP_S, speed])
            rows[k] = state
        return rows
