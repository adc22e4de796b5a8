"""The picture of a fleet's snapshot, as the page draws it.

It adds traffic lights with their reasons, ellipses and true positions.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable

from gcs_coloc.core.alarms.alarms import Alarm, traffic_light
from gcs_coloc.core.error_ellipse import error_ellipse
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import Ellipse, EventsFrame, FleetFrame, VehicleFrame, VehicleHistory, fleet_json

_TRUTH_FRESH_S = 2.0  # chosen: simulators tell where their vehicles are at 1 Hz or faster


class LiveSource:
    """What pages are sent of a live fleet; a `PageSource`.

    `snapshot` returns the fleet with its counters, `recent_snapshot` the fleet as of a moment ago, for many times a second;
    `alarms` brings the service's alarms up to date with a snapshot and returns them, `truths` the true positions that a
    simulation sends.
    """

    edition = 0

    def __init__(
        self,
        snapshot: Callable[[], FleetSnapshot],
        recent_snapshot: Callable[[], FleetSnapshot],
        history: TrackHistory,
        alarms: Callable[[FleetSnapshot], Iterable[Alarm]],
        truths: Callable[[], Iterable[HeardTruth]] = tuple,
    ) -> None:
        self.instance = secrets.token_hex(8)
        self.history = history
        self._alarms = alarms
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
        fleet = self._recent_snapshot()
        messages = [fleet_json(fleet_frame(fleet, self._alarms(fleet), self._truths())).decode()]
        if with_counts:
            messages.append(self.history.counts(self._snapshot()).model_dump_json())
        return messages


def fleet_frame(fleet: FleetSnapshot, alarms: Iterable[Alarm] = (), truths: Iterable[HeardTruth] = ()) -> FleetFrame:
    """The page's picture of one instant."""
    true_enu_m = _true_positions(fleet, truths)
    return FleetFrame(
        at_s=fleet.at_s,
        utc_minus_service_s=fleet.utc_minus_service_s,
        estimator=fleet.estimator,
        origin=fleet.origin,
        vehicles=tuple(_vehicle_frame(v, fleet.loop_lag_s, true_enu_m.get(v.sysid)) for v in fleet.vehicles),
        ranges=fleet.ranges,
        stations=fleet.stations,
        alarms=tuple(alarms),
        standby=fleet.standby,
    )


def ellipse(covariance_h_m2: tuple[float, float, float]) -> Ellipse:
    """The 2-sigma ellipse of a covariance (east-east, east-north, north-north) in square metres."""
    major_m, minor_m, angle_rad = error_ellipse(*covariance_h_m2)
    return Ellipse(semi_major_m=2.0 * major_m, semi_minor_m=2.0 * minor_m, angle_rad=angle_rad)


def _true_positions(fleet: FleetSnapshot, truths: Iterable[HeardTruth]) -> dict[int, Vector3]:
    """Return the true positions that are fresh as east, north, up in m, by system id.

    They come without a height and get the estimate's.
    """
    fresh = [t for t in truths if abs(fleet.at_s - t.at_s) <= _TRUTH_FRESH_S]
    if fleet.origin is None or not fresh:
        return {}
    frame = LocalFrame(*fleet.origin)
    heights = {v.sysid: v.alt_msl_m for v in fleet.vehicles if v.alt_msl_m is not None}
    return {t.sysid: frame.enu_from_geodetic(t.lat_deg, t.lon_deg, heights.get(t.sysid, fleet.origin[2])) for t in fresh}


def _vehicle_frame(v: VehicleSnapshot, loop_lag_s: float, truth_enu_m: Vector3 | None) -> VehicleFrame:
    light, reason = traffic_light(v, loop_lag_s)
    shape = ellipse(v.covariance_h_m2) if v.covariance_h_m2 is not None else None
    return VehicleFrame(snapshot=v, light=light, reason=reason, ellipse=shape, truth_enu_m=truth_enu_m)
