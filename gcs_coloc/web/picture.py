"""From the fleet's view to what the page draws: traffic lights with their reasons, ellipses."""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, sqrt

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.mavlink.truth import HeardTruth
from gcs_coloc.web.wire import Ellipse, FleetFrame, LightColour, PlaybackState, VehicleFrame

SILENT_AFTER_S = 3.0
_TRUTH_FRESH_S = 2.0


def fleet_frame(view: FleetSnapshot, truths: Iterable[HeardTruth] = (), playback: PlaybackState | None = None) -> FleetFrame:
    """The page's picture of one instant."""
    places = _true_places(view, truths)
    return FleetFrame(
        at_s=view.at_s,
        utc_minus_service_s=view.utc_minus_service_s,
        estimator=view.estimator,
        origin=view.origin,
        vehicles=tuple(_vehicle(v, places.get(v.sysid)) for v in view.vehicles),
        ranges=view.ranges,
        playback=playback,
    )


def traffic_light(v: VehicleSnapshot) -> tuple[LightColour, str]:
    """The colour for one vehicle and the reason in words; the worst thing that holds decides."""
    if v.age_s > SILENT_AFTER_S:
        return "bad", f"not heard for {v.age_s:.0f} s; before that: GPS {v.gps_state}, {v.gps_reason}"
    if v.gps_state in ("failed", "recovering"):
        located = f"within {v.bound_95_m:.0f} m (95 %)" if v.bound_95_m is not None else f"nowhere: {v.no_estimate_reason}"
        text = f"GPS {v.gps_state}: {v.gps_reason}. Located {located}; {v.aiding}"
        return ("caution" if v.aiding_has_fix and v.fix_acknowledged is not False else "bad"), text
    if v.gps_state == "suspect":
        return "caution", f"GPS suspect: {v.gps_reason}"
    if v.gps_state == "unknown":
        return "unknown", v.gps_reason
    if v.aiding_override == "on":
        return (
            "caution" if v.aiding_has_fix else "bad"
        ), f"aided by the operator's word ({v.aiding}); GPS healthy: {v.gps_reason}"
    if v.fix_acknowledged is False:
        return "caution", f"GPS healthy ({v.gps_reason}), but {v.aiding}"
    if v.inhibit_reason is not None:
        return "caution", f"GPS healthy ({v.gps_reason}), but it could not be aided: {v.inhibit_reason}"
    return "good", f"GPS healthy: {v.gps_reason}"


def ellipse(covariance_h_m2: tuple[float, float, float]) -> Ellipse:
    """The 2-sigma ellipse of a covariance (east-east, east-north, north-north) in square metres."""
    a, b, d = covariance_h_m2
    mean, half = 0.5 * (a + d), sqrt(0.25 * (a - d) ** 2 + b * b)
    return Ellipse(
        semi_major_m=2.0 * sqrt(max(mean + half, 0.0)),
        semi_minor_m=2.0 * sqrt(max(mean - half, 0.0)),
        angle_rad=0.5 * atan2(2.0 * b, a - d),
    )


def _true_places(view: FleetSnapshot, truths: Iterable[HeardTruth]) -> dict[int, Vector3]:
    """East, north, up in m of those truths that are no older than the picture allows. They come without a height."""
    fresh = [t for t in truths if abs(view.at_s - t.at_s) <= _TRUTH_FRESH_S]
    if view.origin is None or not fresh:
        return {}
    frame = LocalFrame(*view.origin)
    heights = {v.sysid: v.alt_msl_m for v in view.vehicles if v.alt_msl_m is not None}
    return {t.sysid: frame.enu_from_geodetic(t.lat_deg, t.lon_deg, heights.get(t.sysid, view.origin[2])) for t in fresh}


def _vehicle(v: VehicleSnapshot, truth_enu_m: Vector3 | None) -> VehicleFrame:
    light, reason = traffic_light(v)
    shape = ellipse(v.covariance_h_m2) if v.covariance_h_m2 is not None else None
    return VehicleFrame(view=v, light=light, reason=reason, ellipse=shape, truth_enu_m=truth_enu_m)
