"""Drawn flights of a plan through the whole engine.

Messages, clocks, filter, integrity and fix policy take part. Vehicles, errors and links are those of the integrity trials, of
the sizes that the plan's assumptions name. The planned way is swayed by gusts of the size that the filter's settings name, so
what is tested is the prediction and not the settings.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, nan, sqrt

import numpy as np

from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.measurements import FloatArray, VehicleClass
from gcs_coloc.core.stations.stations import Station, StationPosition
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.planning.fleet_plan import FleetPlan, PlannedStation
from gcs_coloc.planning.prediction import WITH_GPS_S
from gcs_coloc.study.integrity.flight_classes import FlightClass, Group
from gcs_coloc.study.integrity.motion import GRAVITY_MPS2, STEP_S, Trajectory, gauss_markov
from gcs_coloc.study.integrity.simulated_fleet import SimulatedFleet
from gcs_coloc.study.integrity.trial import SAMPLE_S, TrialSample, TrialScore, fly_fleet
from sitl_fakes.geodesy import WorldFrame

_KEPT_EVERY_S = 2.0
"""Chosen: errors change little within it."""
_SWAY_RADPS = 0.2
"""An autopilot corrects what a gust displaces within some seconds. Chosen: critically damped, 5 s."""
_LEAST_COLOURED_SHARE = 0.1
"""Chosen: no receiver is without errors that last."""


@dataclass(frozen=True, slots=True)
class DrawnFlight:
    """One flight of the denied vehicle at times `at_s` (N,), s.

    Of each time the horizontal error and the protection level in m, NaN without an estimate, and whether it was sent a fix.
    """

    at_s: FloatArray
    error_m: FloatArray
    hpl_m: FloatArray
    has_fix: FloatArray


def fly_plan(plan: FleetPlan, sysid: int, seed: int) -> DrawnFlight:
    """Fly a plan once with one vehicle denied.

    All its vehicles are in flight from its beginning to its end.
    """
    begin_s, end_s = plan.span_s
    drawn = _as_class(plan)
    rng = np.random.default_rng([seed, sysid])
    sysids = [sysid, *(v for v in plan.paths if v != sysid)]
    courses = [_draw_course(rng, plan, v) for v in sysids]
    places_m = {each.node: each.position_enu_m + each.sigma_m * rng.standard_normal(3) for each in plan.stations}
    fleet = SimulatedFleet(drawn, seed, end_s - begin_s, courses, {node: (e, n, u) for node, (e, n, u) in places_m.items()})
    settings = EngineSettings(
        aiding=plan.assumptions.aiding,
        request_streams=False,
        stations=tuple(_station(fleet.frame, each) for each in plan.stations),
    )
    kept: list[tuple[float, float, float, bool]] = []
    every = round(_KEPT_EVERY_S / SAMPLE_S)

    def keep(sample: TrialSample) -> None:
        if sample.sysid == fleet.denied[0] and round(sample.at_s / SAMPLE_S) % every == 0:
            error_m, hpl_m = (nan if value is None else value for value in (sample.error_m, sample.hpl_m))
            kept.append((begin_s + sample.at_s, error_m, hpl_m, sample.has_fix))

    fly_fleet(fleet, settings, TrialScore(drawn.name, seed), trace=keep)
    at_s, errors_m, hpls_m, fixes = np.array(kept, dtype=float).T
    return DrawnFlight(at_s, errors_m, hpls_m, fixes)


def _as_class(plan: FleetPlan) -> FlightClass:
    """Return the flight class whose errors have the sizes that a plan assumes."""
    a, s = plan.assumptions, FleetSettings()
    white_m = a.position_sigma_m * a.position_white_share
    coloured_m = a.position_sigma_m * max(sqrt(1.0 - a.position_white_share**2), _LEAST_COLOURED_SHARE)
    heading_deg = sqrt(3.0) * degrees(s.heading_sigma_rad)  # drawn uniformly up to it
    return FlightClass(
        name="plan",
        group=Group.NOMINAL,
        text="a plan",
        heading_error_deg=(0.0, heading_deg),
        has_air_data=a.has_air_data,
        gnss_sigma_m=(coloured_m, coloured_m),
        gnss_time_s=(s.report_error_time_s, s.report_error_time_s),
        gnss_white_m=(white_m, white_m),
        gnss_common_m=(0.0, 0.0),
        gnss_stated=(1.0, 1.0),
        filters_positions=white_m == 0.0,
        position_hz=a.position_rate_hz,
        height_drift_m=(a.height_sigma_m, a.height_sigma_m),
        height_bias_m=(0.0, 0.0),
        range_sigma_m=(a.range_sigma_m, a.range_sigma_m),
        range_hz=(a.range_rate_hz, a.range_rate_hz),
        range_loss=(0.0, 0.0),
        max_range_m=a.max_range_m,
        is_mutual=False,
        answers_timesync=a.delay_is_known,
        has_utc=a.delay_is_known,
        lost_at_s=(WITH_GPS_S, WITH_GPS_S),
    )


def _station(frame: WorldFrame, planned: PlannedStation) -> Station:
    lla = frame.to_lla(*planned.position_enu_m)
    return Station(planned.station_id, position=StationPosition(*lla, planned.sigma_m, planned.sigma_m))


def _draw_course(rng: np.random.Generator, plan: FleetPlan, sysid: int) -> Trajectory:
    """Draw the true motion of a vehicle: its planned way, swayed by gusts."""
    settings = FleetSettings()
    begin_s, end_s = plan.span_s
    steps = round((end_s - begin_s) / STEP_S) + 2
    way = plan.paths[sysid].at(begin_s + STEP_S * np.arange(steps, dtype=float))
    sway = _draw_sway(rng, steps, settings.acceleration_density_m2ps3)
    positions_m, velocities_mps = way.positions_m.copy(), way.velocities_mps.copy()
    positions_m[:, :2] += sway[:, :2]
    velocities_mps[:, :2] += sway[:, 2:]
    is_plane = plan.vehicle(sysid).vehicle_class is VehicleClass.PLANE
    if is_plane:
        through_air = velocities_mps[:, :2] + gauss_markov(
            rng, steps, STEP_S, settings.air_noise_mps, settings.air_noise_time_s, axes=2
        )
        yaw_rad = np.arctan2(through_air[:, 0], through_air[:, 1])
        attitude_rad = np.stack([way.bank_rad, np.zeros(steps), yaw_rad], axis=1)
        return Trajectory(positions_m, velocities_mps, attitude_rad, np.hypot(*through_air.T))
    # A copter leans into its accelerations; it heads north.
    east_mps2, north_mps2 = np.gradient(way.velocities_mps[:, :2], STEP_S, axis=0).T
    lean = np.arctan2(east_mps2, GRAVITY_MPS2), -np.arctan2(north_mps2, GRAVITY_MPS2), np.zeros(steps)
    return Trajectory(positions_m, velocities_mps, np.stack(lean, axis=1), None)


def _draw_sway(rng: np.random.Generator, steps: int, density_m2ps3: float) -> FloatArray:
    """Draw sway (N, 4): east, north in m, then m/s; white acceleration on a damped oscillator."""
    rows, state = np.zeros((steps, 4)), np.zeros(4)
    pushes = rng.standard_normal((steps, 2)) * sqrt(density_m2ps3 * STEP_S)
    for k in range(1, steps):
        place, speed = state[:2], state[2:]
        speed = speed + (-2.0 * _SWAY_RADPS * speed - _SWAY_RADPS**2 * place) * STEP_S + pushes[k]
        state = np.concatenate([place + speed * STEP_S, speed])
        rows[k] = state
    return rows
