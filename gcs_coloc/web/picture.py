"""The picture that the page draws of a fleet's snapshot: traffic lights with their reasons, ellipses, true positions."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable

from gcs_coloc.core.error_ellipse import error_ellipse
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import Ellipse, EventsFrame, FleetFrame, LightColour, VehicleFrame, VehicleHistory, fleet_json

SILENT_AFTER_S = 3.0
_TRUTH_FRESH_S = 2.0


class LiveSource:
    """What pages are sent of a live fleet; a `PageSource`.

    `snapshot` returns the fleet with its counters, `recent_snapshot` the fleet as of a moment ago, for many times a second;
    `truths` returns the true positions that a simulation sends.
    """

    edition = 0

    def __init__(
        self,
        snapshot: Callable[[], FleetSnapshot],
        recent_snapshot: Callable[[], FleetSnapshot],
        history: TrackHistory,
        truths: Callable[[], Iterable[HeardTruth]] = tuple,
    ) -> None:
        self.instance = secrets.token_hex(8)
        self.history = history
        self._snapshot = snapshot
        self._recent_snapshot = recent_snapshot
        self._truths = truths

    @property
    def newest_event(self) -> int:
        """As `PageSource` says."""
        return self.history.newest_event

    @property
    def utc_minus_service_s(self) -> float | None:
        """As `PageSource` says."""
        return self._recent_snapshot().utc_minus_service_s

    def events_after(self, number: int) -> EventsFrame:
        """As `PageSource` says."""
        return self.history.events_after(number)

    def tracks(self) -> tuple[VehicleHistory, ...]:
        """As `PageSource` says."""
        return self.history.tracks()

    def messages(self, *, with_counts: bool) -> list[str]:
        """As `PageSource` says."""
        messages = [fleet_json(fleet_frame(self._recent_snapshot(), self._truths())).decode()]
        if with_counts:
            messages.append(self.history.counts(self._snapshot()).model_dump_json())
        return messages


def fleet_frame(fleet: FleetSnapshot, truths: Iterable[HeardTruth] = ()) -> FleetFrame:
    """The page's picture of one instant."""
    true_enu_m = _true_positions(fleet, truths)
    return FleetFrame(
        at_s=fleet.at_s,
        utc_minus_service_s=fleet.utc_minus_service_s,
        estimator=fleet.estimator,
        origin=fleet.origin,
        vehicles=tuple(_vehicle_frame(v, true_enu_m.get(v.sysid)) for v in fleet.vehicles),
        ranges=fleet.ranges,
    )


def traffic_light(v: VehicleSnapshot) -> tuple[LightColour, str]:
    """The colour for one vehicle and the reason in words; the most serious condition decides."""
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
        colour: LightColour = "caution" if v.aiding_has_fix else "bad"
        return colour, f"aiding switched on by the operator ({v.aiding}); GPS healthy: {v.gps_reason}"
    if v.fix_acknowledged is False:
        return "caution", f"GPS healthy ({v.gps_reason}), but {v.aiding}"
    if v.inhibit_reason is not None:
        return "caution", f"GPS healthy ({v.gps_reason}), but it could not be aided: {v.inhibit_reason}"
    return "good", f"GPS healthy: {v.gps_reason}"


def ellipse(covariance_h_m2: tuple[float, float, float]) -> Ellipse:
    """The 2-sigma ellipse of a covariance (east-east, east-north, north-north) in square metres."""
    major_m, minor_m, angle_rad = error_ellipse(*covariance_h_m2)
    return Ellipse(semi_major_m=2.0 * major_m, semi_minor_m=2.0 * minor_m, angle_rad=angle_rad)


def _true_positions(fleet: FleetSnapshot, truths: Iterable[HeardTruth]) -> dict[int, Vector3]:
    """East, north, up in m of the true positions that are fresh. They come without a height and get the estimate's."""
    fresh = [t for t in truths if abs(fleet.at_s - t.at_s) <= _TRUTH_FRESH_S]
    if fleet.origin is None or not fresh:
        return {}
    frame = LocalFrame(*fleet.origin)
    heights = {v.sysid: v.alt_msl_m for v in fleet.vehicles if v.alt_msl_m is not None}
    return {t.sysid: frame.enu_from_geodetic(t.lat_deg, t.lon_deg, heights.get(t.sysid, fleet.origin[2])) for t in fresh}


def _vehicle_frame(v: VehicleSnapshot, truth_enu_m: Vector3 | None) -> VehicleFrame:
    light, reason = traffic_light(v)
    shape = ellipse(v.covariance_h_m2) if v.covariance_h_m2 is not None else None
    return VehicleFrame(snapshot=v, light=light, reason=reason, ellipse=shape, truth_enu_m=truth_enu_m)
