"""Measurement models: h, H and R of each measurement, eq. (10) to (15) and (34).

The equations are in docs/explanation/fleet-filter.md. Each function evaluates h at the state, then its Jacobian H, then the
variances R, in that order, and returns them as a linearised measurement: (H P, minus the innovation) for the correction of
`JointState`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    FloatArray,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    Vector3,
)
from gcs_coloc.estimators.fleet.ekf._kernels import RangeEnd, range_jacobian
from gcs_coloc.estimators.fleet.ekf.state import (
    AIRSPEED_ERROR,
    BARO_ERROR,
    HEADING_ERROR,
    REPORT_ERROR,
    SIZE,
    TIME_STAMP_OFFSET,
    TURN,
    VELOCITY,
    WIND,
    JointState,
)
from gcs_coloc.estimators.fleet.settings import FleetSettings

REPORT_VELOCITY_TIME_S = 1.0
"""Chosen: correlation time of the velocity error of a navigation filter; ten reports in it count as one."""
_ODOMETRY_TIME_S = 1.0
"""Chosen: correlation time of the errors of wheels and of optical flow, slip and scale; as of a navigation filter."""
_COURSE_KNOWN_SHARE = 0.5  # chosen: a velocity known to half of its size has a course; without one a speed is no component of it
_WELL_KNOWN_SHARE = 0.25
"""Chosen: air velocity known to this share of the airspeed is a better point of linearisation than a noisy heading."""
_LEAST_DISTANCE_M = 1e-3  # chosen: below it the direction of a range is rounding
_LEAST_INTERVAL_S = 1e-3  # chosen: bounds the noise of two measurements at the same time
_AIR = ((3, 6), (4, 7))  # components of velocity over ground and wind: east, north
_REPORTED = np.eye(6, SIZE)
_REPORTED[range(3), range(REPORT_ERROR.start, REPORT_ERROR.stop)] = 1.0
"""H of a position report, eq. (11): position with its error in the first three rows, velocity in the rest."""


class LinearisedMeasurement(NamedTuple):
    """A linearised measurement of k values of one vehicle.

    `HA` (k, 1 + n) is what `whiten` needs. `H` (k, 16) is the Jacobian by the vehicle's block, and `where` the slice of this
    block. `R` is the diagonal of the noise covariance.
    """

    HA: FloatArray
    H: FloatArray
    where: slice
    R: list[float]

    def innovation_covariance(self, R: list[float]) -> FloatArray:
        """Return S = H P H' + R (k, k) for the variances R (k,)."""
        S = self.HA[:, self.where] @ self.H.T
        diagonal = S.reshape(-1)[:: len(R) + 1]
        diagonal += R
        return S


def position_report(
    joint: JointState, m: PositionMeasurement, white_sigma_m: tuple[float, float], since_velocity_s: float
) -> LinearisedMeasurement:
    """Linearise a position report with its error, and velocity: h = (p + b_p, v), eq. (11).

    Source: Bar-Shalom, Li, Kirubarajan 2001, section 8.4 (autocorrelated measurement noise as a state); PX4 EKF2 fuses GNSS
    position and velocity alike. R: white sigmas in m (horizontal, vertical); `since_velocity_s` is the time since the last
    velocity was used: a velocity error is correlated too, so more reports a second carry no more information.
    """
    # h
    k = 6 if m.velocity_enu_mps is not None and m.sigma_velocity_mps is not None else 3
    H = _REPORTED[:k]
    HA = joint.predict_block_measurement(m.vehicle, H)
    HA[:, 0] -= m.position_enu_m if k == 3 else (*m.position_enu_m, *(m.velocity_enu_mps or ()))
    # R
    white_h_m2, white_v_m2 = white_sigma_m[0] ** 2, white_sigma_m[1] ** 2
    R = [white_h_m2, white_h_m2, white_v_m2]
    if m.sigma_velocity_mps is not None and k == 6:
        R += [m.sigma_velocity_mps**2 * max(1.0, REPORT_VELOCITY_TIME_S / max(since_velocity_s, _LEAST_INTERVAL_S))] * 3
    return LinearisedMeasurement(HA, H, joint.where[m.vehicle], R)


def altitude(joint: JointState, m: AltitudeMeasurement, white_sigma_m: float) -> tuple[FloatArray, float, float]:
    """Linearise a barometric height with its error: h = p_u + b_h, eq. (12).

    Return HA (1 + n,), the innovation, m, and its variance S, m^2.

    Source: PX4 EKF2, baro height fusion with a height bias estimator. R: the white sigma squared.
    """
    start = joint.where[m.vehicle].start
    b = start + BARO_ERROR
    # h and H P at once: H has two ones.
    hA: FloatArray = joint.A[start + 2] + joint.A[b]
    variance = hA.item(start + 2) + hA.item(b) + white_sigma_m * white_sigma_m
    innovation = m.up_m - hA.item(0)
    hA[0] = -innovation
    return hA, innovation, variance


class AirResiduals(NamedTuple):
    """Air data minus the velocity through the air, along a direction and across it, m/s.

    The direction is the unit vector (`east`, `north`). `speed_mps` is the speed of eq. (13).
    """

    east: float
    north: float
    speed_mps: float
    along_mps: float
    across_mps: float


def air_residuals(ve: float, vn: float, airspeed_mps: float, yaw_rad: float, variance_m2ps2: float) -> AirResiduals:
    """Return what air data show beyond a given horizontal velocity through the air.

    `ve` and `vn` are that velocity, m/s. `variance_m2ps2` is the sum of the variances of both. `airspeed_mps` is the horizontal
    part. It is linearised at that velocity where it is well known: along a noisy measured heading the gain and the innovation
    would share their noise, and slowly shift wind against airspeed error.
    """
    speed = math.hypot(ve, vn)
    if variance_m2ps2 < (_WELL_KNOWN_SHARE * airspeed_mps) ** 2 and speed > 0.5 * airspeed_mps:
        off = math.remainder(yaw_rad - math.atan2(ve, vn), 2.0 * math.pi)
        return AirResiduals(ve / speed, vn / speed, speed, airspeed_mps - speed, speed * off)
    se, sn = math.sin(yaw_rad), math.cos(yaw_rad)
    return AirResiduals(se, sn, airspeed_mps, airspeed_mps - se * ve - sn * vn, se * vn - sn * ve)


def air_velocity(
    joint: JointState, m: AttitudeMeasurement, airspeed_mps: float, since_s: float, s: FleetSettings, noise_level: float
) -> LinearisedMeasurement:
    """Linearise airspeed and heading: h = (|v - w| + b_V, V (course(v - w) + b_psi)), eq. (13).

    Velocities and airspeed are horizontal.

    Source: PX4 EKF2, airspeed and sideslip fusion; here the heading error is a state and sideslip is part of the noise.
    R: the air noise at its learned level, correlated over `air_noise_time_s`, with `since_s` since the last attitude.
    """
    # h
    x, P = joint.mean(m.vehicle).tolist(), joint.covariance(m.vehicle)
    spread = sum(P.item(v, v) - 2.0 * P.item(v, w) + P.item(w, w) for v, w in _AIR)
    V = airspeed_mps * math.cos(m.pitch_rad)
    se, sn, speed, along, across = air_residuals(x[3] - x[6], x[4] - x[7], V, m.yaw_rad, spread)
    # H: along the nose (airspeed), across it (heading).
    H = np.zeros((2, SIZE))
    H[0, VELOCITY.start : WIND.stop] = (se, sn, 0.0, -se, -sn)
    H[1, VELOCITY.start : WIND.stop] = (sn, -se, 0.0, -sn, se)
    H[0, AIRSPEED_ERROR], H[1, HEADING_ERROR] = 1.0, speed
    HA = joint.predict_block_measurement(m.vehicle, H)
    HA[:, 0] = (x[AIRSPEED_ERROR] - along, speed * x[HEADING_ERROR] - across)
    # R
    noise = noise_level * s.air_noise_mps**2 * max(1.0, s.air_noise_time_s / max(since_s, _LEAST_INTERVAL_S))
    return LinearisedMeasurement(HA, H, joint.where[m.vehicle], [noise, noise])


def odometry(joint: JointState, m: OdometryMeasurement, since_s: float) -> LinearisedMeasurement:
    """Linearise the speed and turn rate of odometry: h = (|v|, omega), eq. (34).

    At a stop h = (v_e, v_n, omega). While the course is open, h is omega alone.

    Source: Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 5.4 (odometry). The heading is not known, so the
    velocity in the axes of the vehicle tells its size alone. R: the stated sigmas; the errors of wheels and of optical flow last,
    so more odometry a second, with `since_s` since the last one, carries no more information.
    """
    x, P = joint.mean(m.vehicle), joint.covariance(m.vehicle)
    ve, vn, turn = x.item(3), x.item(4), x.item(TURN)
    speed_mps, measured_mps = math.hypot(ve, vn), math.hypot(m.forward_mps, m.right_mps)
    lasting = max(1.0, _ODOMETRY_TIME_S / max(since_s, _LEAST_INTERVAL_S))
    stopped = measured_mps < m.sigma_velocity_mps
    # h, H
    rows: list[tuple[float, float]] = []
    innovations: list[float] = []
    if stopped:
        rows, innovations = [(1.0, 0.0), (0.0, 1.0)], [-ve, -vn]
    elif P.item(3, 3) + P.item(4, 4) < (_COURSE_KNOWN_SHARE * speed_mps) ** 2:
        rows, innovations = [(ve / speed_mps, vn / speed_mps)], [measured_mps - speed_mps]
    H = np.zeros((len(rows) + 1, SIZE))
    for row, (east, north) in zip(H, rows, strict=False):
        row[VELOCITY.start], row[VELOCITY.start + 1] = east, north
    H[-1, TURN] = 1.0
    HA = joint.predict_block_measurement(m.vehicle, H)
    HA[:, 0] = [-innovation for innovation in (*innovations, m.turn_radps - turn)]
    # R; at a stop the vehicle moves by what was measured, to any side.
    velocity = (m.sigma_velocity_mps**2 + (measured_mps**2 if stopped else 0.0)) * lasting
    return LinearisedMeasurement(HA, H, joint.where[m.vehicle], [velocity] * len(innovations) + [m.sigma_turn_radps**2 * lasting])


class LinearisedRange(NamedTuple):
    """A linearised range.

    `HA` (1 + n,) is what `JointState.correct_scalar` needs. `variance_m2` is that of the innovation. `unit` is the direction from
    b to a.
    """

    HA: FloatArray
    innovation_m: float
    variance_m2: float
    unit: Vector3


def slant_range(
    joint: JointState, ends: tuple[RangeEnd, RangeEnd], pair: int, m: RangeMeasurement, white_m2: float, stamp_sigma_s: float
) -> LinearisedRange | None:
    """Linearise a slant range: h = |d| + b + c + (d/dt |d|) tau, eq. (14).

    Here d = p_a - p_b - l by eq. (10), with the lever arms l = `m.offset_enu_m`; a is `m.from_vehicle`. None means that |d| is
    about zero.

    Second-order terms of eq. (15) (Bar-Shalom, Li, Kirubarajan 2001, section 10.3.2): the mean range to an uncertain position
    is longer than the range to its mean, and its variance larger. `pair` is the index of the pair's b, c stands after it.
    The time-stamp offset tau is that of the vehicle whose clock stamped the range. R: `white_m2`, and closing speed times
    `stamp_sigma_s`.
    """
    # h
    a, b = ends
    (ax, ay, az), (bx, by, bz) = a.position, b.position
    ox, oy, oz = m.offset_enu_m
    dx, dy, dz = ax - bx - ox, ay - by - oy, az - bz - oz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if distance < _LEAST_DISTANCE_M:
        return None
    unit = ux, uy, uz = (dx / distance, dy / distance, dz / distance)
    (ave, avn, avu), (bve, bvn, bvu) = a.velocity, b.velocity
    closing = ux * (ave - bve) + uy * (avn - bvn) + uz * (avu - bvu)
    errors = joint.A.item(0, pair) + joint.A.item(0, pair + 1)
    # H in row 0; the rows below are those of d, for the second-order terms.
    H = range_jacobian(len(joint.A), a, b, unit)
    H[0, pair] = H[0, pair + 1] = 1.0
    clock = a if m.clock_of == a.vehicle else b if m.clock_of == b.vehicle else None
    if clock is not None and clock.time_stamp_offset_s is not None:
        H[0, clock.where.start + TIME_STAMP_OFFSET] += closing
        errors += closing * clock.time_stamp_offset_s
    HA, S = joint.predict_measurement(H)
    (first_order, *_), (_, xx, xy, xz), (_, yx, yy, yz), (_, zx, zy, zz) = S.tolist()
    mx, my, mz = xx * ux + xy * uy + xz * uz, yx * ux + yy * uy + yz * uz, zx * ux + zy * uy + zz * uz
    along = ux * mx + uy * my + uz * mz
    across_trace = max(xx + yy + zz - along, 0.0)
    norm2 = xx * xx + yy * yy + zz * zz + xy * xy + yx * yx + xz * xz + zx * zx + yz * yz + zy * zy
    square = norm2 - 2.0 * (mx * mx + my * my + mz * mz) + along * along
    longer = 0.5 * across_trace / distance
    spread = max(0.5 * square / (distance * distance), 0.0)
    # R
    noise = white_m2 + (closing * stamp_sigma_s) ** 2
    # The expansion fails where the uncertainty is as large as the distance: there it may not outgrow the first order.
    spread = min(spread, along + noise)
    longer = min(longer, math.sqrt(along + noise))
    innovation = m.range_m - (distance + longer + errors)
    hA = HA[0]
    hA[0] = -innovation
    return LinearisedRange(hA, innovation, first_order + spread + noise, unit)
