"""What observers see of the fleet at one instant: plain values, detached from the engine's own state."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.aiding.stream import AidingView
from gcs_coloc.core.error_ellipse import horizontal_sigma_and_bound_95_m
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.gps_health import GpsHealth
from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.measurements import Estimate, FloatArray, NoEstimate, Vector3
from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, PrimaryOverride
from gcs_coloc.core.operator_overrides import OperatorOverrides
from gcs_coloc.core.readiness.vehicle_readiness import VehicleReadiness
from gcs_coloc.core.residual_log import Consistency, RangeSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.core.station_review import StationSnapshot
from gcs_coloc.core.telemetry.reported_state import ReportedState

_ATTITUDE_FRESH_S = 3.0  # chosen: an older heading is not drawn


@dataclass(frozen=True, slots=True)
class LinkSnapshot:
    """Counts of one vehicle's frames since the start of the service.

    `received` is without copies, `lost` are missing by their sequence numbers, `duplicates` are the copies.
    """

    sysid: int
    received: int
    lost: int
    duplicates: int


@dataclass(frozen=True, slots=True)
class OutSnapshot:
    """The ground tools behind one connection string, with counts since the start of the service.

    `tools`: how many can be sent to now. `frames_sent`: frames handed on to them. `frames_accepted`: frames taken from them.
    `dropped`: how often what they were slow to take was dropped. `refused`: how often what they sent was refused.
    """

    name: str
    tools: int
    frames_sent: int
    frames_accepted: int
    dropped: int
    refused: int


# Not frozen, and yet nobody changes one: to make one of so many fields would take four times as long, many times a second.
@dataclass(slots=True)
class VehicleSnapshot:
    """One vehicle as the service sees it; a field is None where it is unknown.

    Positions are in degrees and metres above mean sea level.

    `name` is what the configuration calls it.
    `lat_deg`, `lon_deg`, `alt_msl_m` are the service's estimate, `reported_*` is what the vehicle says of itself.
    `sigma_h_m` is 1-sigma along the worst horizontal direction, `sigma_v_m` that of the height, `bound_95_m` the 95 % horizontal
    bound. `hpl_m` and `vpl_m` are the horizontal and vertical protection level; they assume that nothing of what is
    `untested` (see `ProtectionLevel`) moves the position by more than some 20 m.
    `no_estimate_reason` says why there is no estimate, `no_estimate_code` the same as the code of a `NoEstimateReason`.
    `enu_m` and `velocity_enu_mps` are the estimate in the fleet's frame, `covariance_h_m2` its horizontal covariance (east-east,
    east-north, north-north). `yaw_rad` is the vehicle's own, from true north, clockwise.
    `aiding` says in words what is sent to it, `aiding_has_fix` whether that is a position, `aiding_held_back` whether the other
    service of a hot standby is to send it instead, `fix_acknowledged` whether its receiver shows our fix, `inhibit_reason` why
    nothing can be sent to it. `gps_primary` says what the service does with its GPS_PRIMARY. `gps_override`, `aiding_override`,
    `primary_override` are the operator's decisions on these three, and with `_by` where each came from; None where there is
    none, and in recordings that do not hold it.
    `armed`, `mode` (the name of its flight mode) and `battery_percent` are what the vehicle says of itself.
    `delay_s` is how much longer its newest position was under way than the quickest of the last minute. `clock_method` is how its
    clock is known (TIMESYNC or one-way stamps), `clock_sigma_s` how well.
    `readiness` is whether it would be located if its GPS failed; None while its GPS is not healthy.
    """

    sysid: int
    age_s: float
    autopilot: str
    gps_state: str
    gps_reason: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_msl_m: float | None = None
    sigma_h_m: float | None = None
    bound_95_m: float | None = None
    hdop: float | None = None
    ranges_in_use: int = 0
    no_estimate_reason: str | None = None
    reported_lat_deg: float | None = None
    reported_lon_deg: float | None = None
    aiding: str = "off"
    aiding_has_fix: bool = False
    aiding_held_back: bool = False
    fix_acknowledged: bool | None = None
    gps_primary: str | None = None
    inhibit_reason: str | None = None
    gps_override: str = "auto"
    aiding_override: str = "auto"
    primary_override: str = "auto"
    gps_override_by: str | None = None
    aiding_override_by: str | None = None
    primary_override_by: str | None = None
    sigma_v_m: float | None = None
    hpl_m: float | None = None
    vpl_m: float | None = None
    untested: tuple[int, ...] = ()
    enu_m: tuple[float, float, float] | None = None
    velocity_enu_mps: tuple[float, float, float] | None = None
    covariance_h_m2: tuple[float, float, float] | None = None
    reported_enu_m: tuple[float, float, float] | None = None
    reported_alt_msl_m: float | None = None
    yaw_rad: float | None = None
    armed: bool | None = None
    mode: str | None = None
    battery_percent: int | None = None
    fix_type: int | None = None
    satellites: int | None = None
    delay_s: float | None = None
    clock_method: str | None = None
    clock_sigma_s: float | None = None
    consistency: Consistency | None = None
    name: str = ""
    no_estimate_code: str | None = None
    readiness: VehicleReadiness | None = None


@dataclass(frozen=True, slots=True)
class FleetSnapshot:
    """The whole fleet at one instant, with the counts of everything that was refused, by reason.

    `estimator_counts` is what the estimator made of its measurements, used ones among them. `ranges` and `links` are sorted
    by their system ids, `outs` are the ground tools. `utc_minus_service_s` turns `at_s` into UNIX time; None where the host
    does not know the time. `origin` is the fleet frame's: latitude and longitude in degrees, altitude in metres.
    `loop_lag_s` is by how much the host ran the service late at worst in the last second. `stations` are in order of their ids.
    `noise` is how much worse ranges and positions are than they state. No position is sent beyond `alert_limit_m`.
    `standby` is which of two services sends; None without a hot standby.
    """

    at_s: float
    estimator: str
    vehicles: tuple[VehicleSnapshot, ...]
    refused: dict[str, int]
    estimator_counts: dict[str, int]
    ranges: tuple[RangeSnapshot, ...] = ()
    links: tuple[LinkSnapshot, ...] = ()
    outs: tuple[OutSnapshot, ...] = ()
    utc_minus_service_s: float | None = None
    origin: tuple[float, float, float] | None = None
    loop_lag_s: float = 0.0
    stations: tuple[StationSnapshot, ...] = ()
    noise: NoiseModel = field(default_factory=NoiseModel)
    alert_limit_m: float = field(default_factory=lambda: AidingSettings().alert_limit_m)
    standby: StandbySnapshot | None = None


def vehicle_snapshot(
    vehicle: ReportedState,
    where: Estimate | NoEstimate,
    frame: LocalFrame | None,
    *,
    name: str,
    gps_health: GpsHealth,
    overrides: OperatorOverrides,
    aiding: AidingView,
    delay_s: float | None,
    clock: tuple[str, float] | None,
    consistency: Consistency | None,
    readiness: VehicleReadiness | None,
    now_s: float,
) -> VehicleSnapshot:
    """Gather one vehicle at service time `now_s`, from the results of all stages.

    `where` is the estimate for that time, `frame` the fleet's, `clock` how its clock is known with the 1-sigma in s.
    """
    sysid, attitude = vehicle.sysid, vehicle.attitude
    fresh = attitude is not None and now_s - attitude.received_at_s <= _ATTITUDE_FRESH_S
    view = VehicleSnapshot(
        sysid=sysid,
        name=name,
        age_s=now_s - vehicle.last_heard_s,
        autopilot=vehicle.autopilot.value if vehicle.autopilot is not None else "unknown",
        gps_state=gps_health.state.value,
        gps_reason=gps_health.reason.text,
        aiding=aiding.status,
        aiding_has_fix=aiding.has_fix,
        aiding_held_back=aiding.is_held_back,
        fix_acknowledged=aiding.fix_acknowledged,
        gps_primary=aiding.gps_primary,
        inhibit_reason=aiding.inhibit_reason,
        gps_override=overrides.of(sysid, GpsOverride).value,
        aiding_override=overrides.of(sysid, AidingOverride).value,
        primary_override=overrides.of(sysid, PrimaryOverride).value,
        gps_override_by=overrides.source(sysid, GpsOverride),
        aiding_override_by=overrides.source(sysid, AidingOverride),
        primary_override_by=overrides.source(sysid, PrimaryOverride),
        yaw_rad=attitude.yaw_rad if attitude is not None and fresh else None,
        armed=vehicle.armed,
        mode=vehicle.mode,
        battery_percent=vehicle.system.battery_percent if vehicle.system is not None else None,
        delay_s=delay_s,
        clock_method=clock[0] if clock is not None else None,
        clock_sigma_s=clock[1] if clock is not None else None,
        consistency=consistency,
        readiness=readiness,
    )
    if isinstance(where, NoEstimate):
        view.no_estimate_reason, view.no_estimate_code = where.reason.text, where.reason.reason.code
    elif frame is not None:
        P = where.covariance
        view.enu_m = _vector3(where.position_enu_m)
        view.velocity_enu_mps = _vector3(where.velocity_enu_mps)
        view.covariance_h_m2 = (P.item(0, 0), P.item(0, 1), P.item(1, 1))
        view.sigma_h_m, view.bound_95_m = horizontal_sigma_and_bound_95_m(P)
        view.sigma_v_m = sqrt(P.item(2, 2))
        if where.protection is not None:
            view.hpl_m, view.vpl_m, view.untested = where.protection
        view.hdop, view.ranges_in_use = where.hdop, where.ranges_in_use
        view.lat_deg, view.lon_deg, view.alt_msl_m = frame.geodetic_from_enu(*view.enu_m)
    reported, receiver = vehicle.position, vehicle.receiver
    if reported is not None:
        place = reported.lat_deg, reported.lon_deg, reported.alt_msl_m
        view.reported_lat_deg, view.reported_lon_deg, view.reported_alt_msl_m = place
        view.reported_enu_m = frame.enu_from_geodetic(*place) if frame is not None else None
    if receiver is not None:
        view.fix_type, view.satellites = receiver.fix_type, receiver.satellites
    return view


def _vector3(array: FloatArray) -> Vector3:
    x, y, z = array.tolist()
    return x, y, z
