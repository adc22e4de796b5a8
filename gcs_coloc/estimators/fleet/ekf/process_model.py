"""The process model of one vehicle: F and Q of a step, eq. (2) to (9), (42), (46), (47).

Steady flight is constant velocity disturbed by white acceleration (Bar-Shalom, Li, Kirubarajan 2001, section 6.2.2). With a
fresh bank angle the velocity through the air turns at the rate of a coordinated turn and the wind carries the vehicle along;
the acceleration that is left to chance is then much smaller. Without one the turn rate is a state (section 11.7, the nearly
coordinated turn). All slow errors are first-order Gauss-Markov processes (section 8.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from gcs_coloc.core.error_ellipse import eigenvalue_mean_and_radius
from gcs_coloc.core.measurements import AttitudeMeasurement, FloatArray
from gcs_coloc.core.telemetry.reported_state import LEAST_AIRSPEED_MPS
from gcs_coloc.estimators.fleet.ekf._kernels import Transition
from gcs_coloc.estimators.fleet.ekf.possible_motion import BOUND_95_SIGMAS, CORRELATION, Motion
from gcs_coloc.estimators.fleet.ekf.records import VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import TURN
from gcs_coloc.estimators.fleet.ekf.tilt import GRAVITY_MPS2, STEEPEST_BANK_RAD
from gcs_coloc.estimators.fleet.settings import FleetSettings

GAP_S = 1.5
"""Chosen: after a gap of this length between ranges a manoeuvre may have passed unobserved; one range may be lost at 1 Hz."""
ATTITUDE_HELD_S = 2.5
"""An attitude that is no longer fresh is held for so long, but shows no turn. Chosen: it comes every two seconds, some late."""
_COAST_TIME_S = 2.0  # chosen: without an update for longer the process noise is inflated; shorter gaps are usual on a radio link
_COAST_GAIN = 5.0  # chosen: the most by which a gap inflates; more makes a vehicle out of range needlessly uncertain
_NOTICED_SIGMA_M = 10.0  # chosen: a denied vehicle known worse than this shows a manoeuvre late, so its process noise is inflated
_UNNOTICED_GAIN = 20.0  # chosen: the most by which a large position variance inflates
NOTICED_INTERVAL_S, _MOST_LATE = 0.2, 10.0
"""Chosen: the white acceleration of the settings is for ranges at 5 Hz; ranges every two seconds show where a vehicle was."""
_TURN_SHOWN_SIGMA_M = 1.0  # chosen: a position known better than this along some direction shows a turn within a second
_TURN_GAIN = 6.0  # chosen: the most by which the turn rate's sigma is inflated: 6 * 0.03 rad/s is 10 degrees a second
_MANOEUVRE_S = 1.0
"""Chosen: correlation time of manoeuvres that recur; a density q of white acceleration is 2 T sigma^2 (Singer 1970)."""
_SLIP_DENSITY_M2PS3 = 0.03  # chosen: wheels that slip change the velocity by 0.17 m/s within a second
_MEASURED_TURN_RADPS = 1.0  # chosen: 1-sigma of a turn rate that odometry measures; a robot turns on the spot
_UNEVEN_TURN_TIME_S = 1.0
"""Chosen: correlation time of the acceleration error in a turn; its density is 2 T sigma^2 (Singer 1970)."""
_LEAST_OWN_SHARE = 1e-3
"""Chosen: bounds the correlation time of a clock's offset at 1000 times that of a vehicle's own time-stamp error."""
_LONGEST_STEP_S = 0.5  # chosen: a turn bends the path; F is linearised anew at least this often
_MOST_STEPS = 40  # chosen: bounds the work of one propagation after a long silence


def turn_rate_radps(roll_rad: float, airspeed_mps: float) -> float:
    """Return the rate of a coordinated turn, clockwise positive: omega = g tan(roll) / V, eq. (2)."""
    return GRAVITY_MPS2 * math.tan(roll_rad) / airspeed_mps


def usable_airspeed_mps(m: AttitudeMeasurement) -> float | None:
    """Return an attitude's airspeed where it is fast and level enough for eq. (2) and (13), else None."""
    is_usable = m.airspeed_mps is not None and m.airspeed_mps >= LEAST_AIRSPEED_MPS and abs(m.roll_rad) <= STEEPEST_BANK_RAD
    return m.airspeed_mps if is_usable else None


def acceleration_density_m2ps3(east_mps: float, north_mps: float, s: FleetSettings) -> tuple[float, float]:
    """Return how slow a velocity is, and the density of the white acceleration with it, eq. (8).

    The slowness is 1 at rest and 0 when fast. The density is in m^2/s^3. A slow vehicle turns on the spot, which a turn rate does
    not describe.
    """
    slowness = 1.0 / (1.0 + (east_mps * east_mps + north_mps * north_mps) / (s.low_speed_mps * s.low_speed_mps))
    return slowness, s.acceleration_density_m2ps3 + slowness * (s.low_speed_density_m2ps3 - s.acceleration_density_m2ps3)


def step_ends(from_s: float, to_s: float) -> Sequence[float]:
    """Return the ends of the steps of a propagation to a later time, s; empty if it is not later."""
    span_s = to_s - from_s
    if span_s <= _LONGEST_STEP_S:
        return (to_s,) if span_s > 0.0 else ()
    count = min(math.ceil(span_s / _LONGEST_STEP_S), _MOST_STEPS)
    return [from_s + span_s * i / count for i in range(1, count)] + [to_s]


def set_transition(
    transition: Transition,
    record: VehicleRecord,
    s: FleetSettings,
    state: tuple[Sequence[float], FloatArray],
    step_s: float,
    at_s: float,
) -> tuple[float, ...]:
    """Fill F and Q of a step to `at_s`; return the first five components of the mean after it.

    A negative step goes back in time. `state` is mean (16,) and covariance (16, 16) before the step.
    """
    x, P = state
    length = abs(step_s)
    slowness, density = acceleration_density_m2ps3(x[3], x[4], s)
    climb = s.climb_density_m2ps3
    if record.denied_vehicle and not record.has_height:
        # Without a height of its own a climb is observed late, and a fast vehicle climbs fast.
        climb += (1.0 - slowness) * max(s.unobserved_climb_density_m2ps3 - climb, 0.0)
    else:
        climb *= record.profile.climb_level
    gain, gain_v = record.manoeuvre.gains()
    # The turn rate decays within the step: the heading changes by omega times this.
    lasting_s = math.copysign(s.turn_time_s * -math.expm1(-length / s.turn_time_s), step_s)
    attitude, measured = held_attitude(record, s, at_s), False
    is_fresh = fresh_attitude(record, s, at_s) is not None
    airspeed_mps, across_mps2, uneven, gusts, tilt_share = None, 0.0, 0.0, 0.0, 0.0
    level = record.gust_noise.level
    if attitude is not None:
        airspeed_mps = attitude.airspeed_mps
        across_mps2 = GRAVITY_MPS2 * math.tan(min(max(attitude.roll_rad, -STEEPEST_BANK_RAD), STEEPEST_BANK_RAD))
        # A steep turn is never quite level: missing or excess lift accelerates sideways and vertically.
        uneven = 2.0 * _UNEVEN_TURN_TIME_S * (s.turn_error_share * across_mps2) ** 2
        gusts = level * s.coordinated_turn_density_m2ps3
        climb += uneven
    turn = across_mps2 / airspeed_mps if airspeed_mps is not None else x[TURN] * lasting_s / step_s
    if is_fresh and airspeed_mps is not None:
        density = gusts
    else:
        tilt_share = record.tilt.held_share(at_s - step_s, at_s) if record.tilt is not None else 0.0
        manoeuvres = record.manoeuvre_noise
        level = min(manoeuvres.level if tilt_share > 0.0 else manoeuvres.untold_level, _most_level(record, P))
        density = max(_late_level(level, record) * density, gusts)
        if measured := has_fresh_odometry(record, s, at_s):
            # What is left to chance is slip: odometry measures the turn, and the speed ten times as fast as it changes.
            density = min(density, _SLIP_DENSITY_M2PS3)
        elif at_s - record.updated_at_s > _COAST_TIME_S:
            gain = max(gain, min(((at_s - record.updated_at_s) / _COAST_TIME_S) ** 2, _COAST_GAIN))
        if record.denied_vehicle:
            gain = max(gain, min(_variances_m2(P)[1] / (_NOTICED_SIGMA_M * _NOTICED_SIGMA_M), _UNNOTICED_GAIN))
    # Eq. (9): the manoeuvre detector inflates the process noise, up to what a learned level may come to as well.
    gain = min(gain, s.manoeuvre_gain / max(level, 1.0))
    mean = transition.set_motion(x, step_s, turn, in_wind=airspeed_mps is not None)
    if airspeed_mps is None:
        transition.set_turn_column(step_s, lasting_s, mean[3], mean[4])
        if attitude is not None:
            mean = _accelerated(mean, across_mps2 * math.cos(attitude.yaw_rad), -across_mps2 * math.sin(attitude.yaw_rad), step_s)
        elif record.tilt is not None and tilt_share > 0.0:
            east_mps2, north_mps2 = record.tilt.acceleration_mps2
            mean = _accelerated(mean, tilt_share * east_mps2, tilt_share * north_mps2, step_s)
            uneven = tilt_share * record.tilt.error_density_m2ps3
        if record.denied_vehicle and at_s - record.updated_at_s > GAP_S and not measured:
            # Eq. (28): no vehicle becomes ever faster. Turns such as it has shown make it no faster than it was.
            limits = record.profile
            square_m2ps2 = x[3] * x[3] + x[4] * x[4] + P.item(3, 3) + P.item(4, 4)
            turned = density / square_m2ps2 if limits.is_recurring else 0.0
            decay = math.exp(-length * max(2.0 * density * gain / limits.max_speed_mps**2, turned))
            decay_v = math.exp(-0.5 * length * climb / limits.max_climb_mps**2)
            transition.decay_velocity(decay, decay_v)
            mean = (*mean[:3], decay * mean[3], decay * mean[4])
    transition.set_acceleration_noise(length, (density + uneven) * gain, climb * min(gain_v, s.manoeuvre_gain))
    # Only the vehicle's own part of the time-stamp offset changes; the offset of its clock lasts.
    stamp_s = record.time_stamp_offset_sigma_s
    own = s.time_stamp_offset_sigma_s / stamp_s if stamp_s > 0.0 else 0.0
    stamp_time_s = s.time_stamp_offset_time_s / max(own * own, _LEAST_OWN_SHARE)
    turn_sigma_radps = _MEASURED_TURN_RADPS if measured else s.turn_sigma_radps * min(math.sqrt(gain), _TURN_GAIN)
    transition.set_gauss_markov(
        length,
        (s.wind_time_s, s.air_error_time_s, s.baro_error_time_s, s.report_error_time_s, stamp_time_s, s.turn_time_s),
        (
            *(s.wind_sigma_mps, s.airspeed_sigma_mps, s.heading_sigma_rad, record.baro_error_sigma_m),
            *(record.report_error_sigma_h_m, record.report_error_sigma_v_m, stamp_s, turn_sigma_radps),
        ),
    )
    return mean


def _accelerated(mean: tuple[float, ...], east_mps2: float, north_mps2: float, step_s: float) -> tuple[float, ...]:
    """Return a mean with a constant acceleration over the step before added, eq. (44), (47).

    `mean` holds its first five components after that step without the acceleration.
    """
    e, n, u, ve, vn = mean
    half_s2 = 0.5 * step_s * step_s
    return e + half_s2 * east_mps2, n + half_s2 * north_mps2, u, ve + step_s * east_mps2, vn + step_s * north_mps2


def gap_covariance(record: VehicleRecord, s: FleetSettings, at_s: float, most_mps2: float = math.inf) -> Motion:
    """Return what a vehicle may have done since its last measurement, at `most_mps2`, eq. (29)."""
    return motion_since(record.updated_at_s, record, s, at_s, most_mps2)


def motion_since(from_s: float, record: VehicleRecord, s: FleetSettings, at_s: float, most_mps2: float = math.inf) -> Motion:
    """Return what a vehicle may have done since a time, eq. (29), per horizontal axis.

    With an acceleration of at most that of its class, and `most_mps2`. It is nothing with a fresh attitude or odometry, which
    shows the turns, and within `GAP_S`.
    """
    since_s = at_s - from_s
    if not GAP_S < since_s < math.inf:
        return 0.0, 0.0, 0.0
    if shows_its_motion(record, s, at_s):
        return 0.0, 0.0, 0.0
    limits = record.profile
    most_mps2 = min(most_mps2, limits.max_acceleration_mps2)
    reach_m = limits.reach_m(since_s, most_mps2) / BOUND_95_SIGMAS
    change_mps = min(most_mps2 * since_s / BOUND_95_SIGMAS, 0.5 * limits.max_speed_mps)
    return reach_m * reach_m, change_mps * change_mps, CORRELATION * reach_m * change_mps


def shown_acceleration_mps2(record: VehicleRecord, s: FleetSettings) -> float:
    """Return the 95 % bound of the shown acceleration, eq. (36); infinite where manoeuvres do not recur."""
    if not record.profile.is_recurring:
        return math.inf
    return BOUND_95_SIGMAS * math.sqrt(record.manoeuvre_noise.untold_level * s.low_speed_density_m2ps3 / (2.0 * _MANOEUVRE_S))


def held_attitude(record: VehicleRecord, s: FleetSettings, at_s: float) -> AttitudeMeasurement | None:
    """Return the newest attitude, fresh or held: a turn mostly lasts longer; None where it is older.

    Without an airspeed it is not held: nothing turns the heading that a bank accelerates across, eq. (44).
    """
    attitude = record.attitude
    if attitude is not None and attitude.airspeed_mps is None:
        return fresh_attitude(record, s, at_s)
    held_s = max(s.attitude_fresh_s, ATTITUDE_HELD_S) if s.attitude_fresh_s > 0.0 else 0.0
    return attitude if attitude is not None and at_s - attitude.measured_at_s <= held_s else None


def fresh_attitude(record: VehicleRecord, s: FleetSettings, at_s: float) -> AttitudeMeasurement | None:
    """Return the newest attitude, which shows turns; None where it is older than `attitude_fresh_s`."""
    attitude = record.attitude
    return attitude if attitude is not None and at_s - attitude.measured_at_s <= s.attitude_fresh_s else None


def fresh_air_data(record: VehicleRecord, s: FleetSettings, at_s: float) -> AttitudeMeasurement | None:
    """Return a vehicle's newest attitude if it is fresh and its airspeed is not refused, else None."""
    attitude = fresh_attitude(record, s, at_s)
    return attitude if attitude is not None and attitude.airspeed_mps is not None else None


def has_fresh_odometry(record: VehicleRecord, s: FleetSettings, at_s: float) -> bool:
    """Whether a vehicle's newest odometry is no older than an attitude may be; it shows the turns as well."""
    return record.odometry is not None and at_s - record.odometry.measured_at_s <= s.attitude_fresh_s


def shows_its_motion(record: VehicleRecord, s: FleetSettings, at_s: float) -> bool:
    """Whether a vehicle's attitude with airspeed, or its odometry, is fresh and shows its turns."""
    return fresh_air_data(record, s, at_s) is not None or has_fresh_odometry(record, s, at_s)


def _late_level(level: float, record: VehicleRecord) -> float:
    """Return a level of white acceleration as it is where ranges come slowly, eq. (46).

    A manoeuvre is noticed by the ranges to two neighbours: the later, the longer their intervals. A plane's level is multiplied
    by that. The level of manoeuvres that recur has it in it, but one that hovered may leave at once.
    """
    profile = record.profile
    if not record.denied_vehicle or not record.neighbours or (profile.is_recurring and not profile.leaves_at_once):
        return level
    intervals_s = sorted([neighbour.interval_s for neighbour in record.neighbours.values()])[:2]
    late = min(max(intervals_s[-1] / NOTICED_INTERVAL_S, 1.0), _MOST_LATE)
    return max(level, late - 1.0) if profile.is_recurring else level * late


def _most_level(record: VehicleRecord, P: FloatArray) -> float:
    """Return the largest noise level of a vehicle without a fresh bank angle, eq. (42).

    A turn changes the velocity along any direction. So the manoeuvre detector notices that of a plane by the one known best.
    """
    most = record.profile.noise_levels[1]
    return most if record.profile.is_recurring else min(most, 1.0 + _variances_m2(P)[0] / _TURN_SHOWN_SIGMA_M**2)


def _variances_m2(P: FloatArray) -> tuple[float, float]:
    """Return the eigenvalues of the horizontal position covariance, the smaller first, m^2."""
    mean_m2, radius_m2 = eigenvalue_mean_and_radius(P.item(0, 0), P.item(0, 1), P.item(1, 1), math.hypot)
    return mean_m2 - radius_m2, mean_m2 + radius_m2
