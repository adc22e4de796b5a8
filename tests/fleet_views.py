"""Views of a vehicle and a fleet for the tests of those who look on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState, VehicleReadiness
from gcs_coloc.core.residual_log import Consistency, RangeSnapshot
from gcs_coloc.core.snapshot import FleetSnapshot, LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot

HEALTHY = VehicleSnapshot(
    sysid=1,
    age_s=0.1,
    autopilot="ArduPilot",
    gps_state="healthy",
    gps_reason="fix type 3, 10 satellites",
    lat_deg=47.0,
    lon_deg=8.0,
    alt_msl_m=500.0,
    sigma_h_m=0.8,
    bound_95_m=1.8,
    hdop=None,
    ranges_in_use=0,
    no_estimate_reason=None,
    reported_lat_deg=47.0,
    reported_lon_deg=8.0,
    aiding="off",
    enu_m=(0.0, 0.0, 0.0),
    velocity_enu_mps=(0.0, 0.0, 0.0),
    covariance_h_m2=(0.64, 0.0, 0.64),
    reported_enu_m=(0.0, 0.0, 0.0),
)
READY = VehicleReadiness(ReadinessState.READY, 8.0, None, "", 3, 2.9, 2.2, 15.0, 13.5, 1.1, 1.2)
NOT_READY = VehicleReadiness(
    ReadinessState.NOT_READY, 8.0, "in_line", "peers 2 and 3 in one line with it: HDOP 9", 2, 2.9, 40.0, 15.0, 120.0, 8.0, 9.0
)
LOCATED = replace(
    HEALTHY,
    sysid=4,
    gps_state="failed",
    gps_reason="no 3D fix: fix type 1",
    sigma_h_m=3.0,
    sigma_v_m=4.0,
    bound_95_m=6.6,
    hdop=1.2,
    ranges_in_use=3,
    aiding="sending 3D fix",
    aiding_has_fix=True,
    enu_m=(120.0, 40.0, 5.0),
    consistency=Consistency(0.5, 0.3, 0.6, 150, 3),
    delay_s=0.02,
)
LOST = replace(
    LOCATED,
    lat_deg=None,
    lon_deg=None,
    alt_msl_m=None,
    sigma_h_m=None,
    sigma_v_m=None,
    bound_95_m=None,
    hdop=None,
    ranges_in_use=0,
    no_estimate_reason="no ranges for 12 s",
    aiding="sending no fix",
    aiding_has_fix=False,
    enu_m=None,
    velocity_enu_mps=None,
    covariance_h_m2=None,
    consistency=None,
)


STANDBY = StandbySnapshot(
    own="254/191",
    state="standby",
    reason="it has started",
    since_s=1.0,
    term=3,
    sends="other",
    other="254/192",
    other_state="active",
    other_age_s=0.1,
    fed_sysid=4,
    problem=None,
)


def fleet_view(at_s: float = 10.0, *vehicles: VehicleSnapshot, **other: Any) -> FleetSnapshot:
    """A fleet of the given vehicles, of a healthy and a located one by default."""
    seen = vehicles or (HEALTHY, LOCATED)
    links = tuple(LinkSnapshot(v.sysid, round(20 * at_s), round(at_s), 0) for v in seen)
    ranges = (RangeSnapshot(4, 1, 0.1, 1.5, 2.0, 0.56, None),)
    outs = (OutSnapshot("udpout:127.0.0.1:14551", 1, round(40 * at_s), 12, 3, 2),)
    return FleetSnapshot(
        at_s, "fleet", seen, {"bad_crc": 3}, {"used": 7}, **{"ranges": ranges, "links": links, "outs": outs} | other
    )
