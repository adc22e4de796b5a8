"""One vehicle as observers see it: its record, the estimator's answer and its aid, gathered into plain values."""

from __future__ import annotations

from math import sqrt

from gcs_coloc.core.aiding.aiding import AidingView
from gcs_coloc.core.error_ellipse import horizontal_sigma_and_bound_95_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.measurements import Estimate, FloatArray, NoEstimate, Vector3
from gcs_coloc.core.messages.control import GpsOverride
from gcs_coloc.core.snapshot import Consistency, VehicleSnapshot
from gcs_coloc.core.telemetry.reported_state import ReportedState

_ATTITUDE_FRESH_S = 3.0


def vehicle_snapshot(
    vehicle: ReportedState,
    where: Estimate | NoEstimate,
    frame: LocalFrame | None,
    *,
    gps_state: GpsState,
    gps_reason: str,
    gps_override: GpsOverride,
    aiding: AidingView,
    delay_s: float | None,
    clock: tuple[str, float] | None,
    consistency: Consistency | None,
    now_s: float,
) -> VehicleSnapshot:
    """Gather one vehicle at service time `now_s`, from the results of all stages.

    `where` is the estimate for that time, `frame` the fleet's, `clock` how its clock is known with the 1-sigma in s.
    """
    enu_m = velocity_mps = covariance_m2 = lat_deg = lon_deg = alt_msl_m = reported_enu_m = None
    sigma_h_m = sigma_v_m = bound_95_m = hdop = None
    ranges_in_use = 0
    if isinstance(where, Estimate) and frame is not None:
        P = where.covariance
        e, n, u = enu_m = _vector3(where.position_enu_m)
        velocity_mps = _vector3(where.velocity_enu_mps)
        covariance_m2 = (P.item(0, 0), P.item(0, 1), P.item(1, 1))
        sigma_h_m, bound_95_m = horizontal_sigma_and_bound_95_m(P)
        sigma_v_m = sqrt(P.item(2, 2))
        hdop, ranges_in_use = where.hdop, where.ranges_in_use
        lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(e, n, u)
    reported, receiver, attitude = vehicle.position, vehicle.receiver, vehicle.attitude
    if reported is not None and frame is not None:
        reported_enu_m = frame.enu_from_geodetic(reported.lat_deg, reported.lon_deg, reported.alt_msl_m)
    fresh = attitude is not None and now_s - attitude.received_at_s <= _ATTITUDE_FRESH_S
    return VehicleSnapshot(
        sysid=vehicle.sysid,
        age_s=now_s - vehicle.last_heard_s,
        autopilot=vehicle.autopilot.value if vehicle.autopilot is not None else "unknown",
        gps_state=gps_state.value,
        gps_reason=gps_reason,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=alt_msl_m,
        sigma_h_m=sigma_h_m,
        bound_95_m=bound_95_m,
        hdop=hdop,
        ranges_in_use=ranges_in_use,
        no_estimate_reason=where.reason if isinstance(where, NoEstimate) else None,
        reported_lat_deg=reported.lat_deg if reported is not None else None,
        reported_lon_deg=reported.lon_deg if reported is not None else None,
        aiding=aiding.status,
        aiding_has_fix=aiding.has_fix,
        fix_acknowledged=aiding.fix_acknowledged,
        gps_primary=aiding.gps_primary,
        inhibit_reason=aiding.inhibit_reason,
        gps_override=gps_override.value,
        aiding_override=aiding.aiding_override.value,
        primary_override=aiding.primary_override.value,
        sigma_v_m=sigma_v_m,
        enu_m=enu_m,
        velocity_enu_mps=velocity_mps,
        covariance_h_m2=covariance_m2,
        reported_enu_m=reported_enu_m,
        yaw_rad=attitude.yaw_rad if attitude is not None and fresh else None,
        fix_type=receiver.fix_type if receiver is not None else None,
        satellites=receiver.satellites if receiver is not None else None,
        delay_s=delay_s,
        clock_method=clock[0] if clock is not None else None,
        clock_sigma_s=clock[1] if clock is not None else None,
        consistency=consistency,
    )


def _vector3(array: FloatArray) -> Vector3:
    x, y, z = array.tolist()
    return x, y, z
