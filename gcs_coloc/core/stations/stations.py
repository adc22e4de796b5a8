"""The fixed stations of a fleet, from the configuration and from RANGING_BEACON messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import hypot
from typing import Literal, NamedTuple

from gcs_coloc.core.geodesy import LocalFrame, horizontal_distance_m
from gcs_coloc.core.measurements import PositionMeasurement, Vector3
from gcs_coloc.core.messages.inbound import FIX_3D, Beacon, BeaconPosition, GpsReceiver, PeerRange
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.stations.node_id import is_station, is_system_id, node_name, station_id_of, station_node

BeaconIds = Literal["stations", "vehicles"]
"""Whose ids the `beacon_id` of a RANGING_BEACON without a position are."""

STATION_SIGMA_M = 1.0
"""1-sigma of a station's position on each axis unless told. Chosen: a few minutes of a receiver without corrections."""
LEAST_STATION_SIGMA_M, MOST_STATION_SIGMA_M = 0.01, 1000.0
"""Chosen: the best survey; beyond a kilometre a place is not known."""
MAX_STATIONS = 256
"""Chosen: more than a site has; bounds what forged messages may fill."""
_TOLD_EVERY_S = 60.0  # chosen: a reminder now and then
_MAX_TOLD = 256  # chosen: the same remedy once a minute, and bounded in memory
_CONTRADICTS_SIGMAS, _CONTRADICTS_M = 3.0, 1.0
"""Chosen: farther than three sigmas of both positions and than rounding they are two places."""


class StationSource(StrEnum):
    """Where a station's position comes from."""

    CONFIGURED = "configured"
    STATED = "stated"
    """By the RANGING_BEACON messages of a vehicle."""
    SURVEYED = "surveyed"
    """By the ranges of vehicles with GPS. It locates nobody until the configuration has it."""


class StationPosition(NamedTuple):
    """Where a station is: degrees, metres above mean sea level, 1-sigmas per axis in m."""

    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    sigma_h_m: float
    sigma_v_m: float


@dataclass(frozen=True, slots=True)
class Station:
    """One station of the fleet.

    `position` is None where it is not known. `range_bias_m` and `range_scale` are the lasting errors of its ranging device, as
    `MeasurementSettings` has those of vehicles.
    """

    station_id: int
    name: str = ""
    position: StationPosition | None = None
    source: StationSource = StationSource.CONFIGURED
    range_bias_m: float = 0.0
    range_scale: float = 0.0

    @property
    def node(self) -> int:
        """Its node id."""
        return station_node(self.station_id)

    @property
    def label(self) -> str:
        """Its id and name in words."""
        return f"{node_name(self.node)} ({self.name})" if self.name else node_name(self.node)

    def measurement(self, frame: LocalFrame, at_s: float) -> PositionMeasurement | None:
        """Return its position at a time, as a vehicle at rest would report it; None where it is not known."""
        if self.position is None:
            return None
        lat_deg, lon_deg, alt_msl_m, sigma_h_m, sigma_v_m = self.position
        enu_m = frame.enu_from_geodetic(lat_deg, lon_deg, alt_msl_m)
        at_rest: Vector3 = (0.0, 0.0, 0.0)
        return PositionMeasurement(self.node, at_s, at_s, enu_m, sigma_h_m, sigma_v_m, at_rest, static=True)


class ResolvedRange(NamedTuple):
    """A range after its other end was found: a vehicle or a station.

    `message` is None where the range is refused. `notice` is what the operator must know. `unplaced` is the station of a range
    that is refused for want of its position: the range may help to survey it.
    """

    message: PeerRange | None
    notice: Notice | None = None
    unplaced: Station | None = None


class Stations:
    """The stations of one fleet.

    `refused` counts the ranges that are refused, and the positions that contradict each other. `first_ranged_s` is when the
    first range to a station whose position is known came.
    """

    def __init__(
        self,
        configured: Sequence[Station] = (),
        beacon_ids: BeaconIds = "stations",
        default_sigmas_m: tuple[float, float] = (5.0, 8.0),
    ) -> None:
        """`default_sigmas_m`: horizontal and vertical 1-sigma of a position that is stated without."""
        self.refused: Counter[CoreRefusal] = Counter()
        self._stations = {station.node: station for station in configured}
        self._beacon_ids = beacon_ids
        self._default_sigmas_m = default_sigmas_m
        self._geoid_height_m: float | None = None
        self._told: dict[tuple[CoreRefusal, int], float] = {}
        self._ranged_s: dict[int, float] = {}
        self.first_ranged_s: float | None = None

    def __iter__(self) -> Iterator[Station]:
        """Iterate over the stations, in the order of their ids."""
        return iter(sorted(self._stations.values(), key=lambda station: station.station_id))

    def get(self, node: int) -> Station | None:
        """Return a station by its node id, None where it is not known."""
        return self._stations.get(node)

    def is_placed(self, node: int) -> bool:
        """Return whether a station's position is known, so that ranges to it locate vehicles."""
        station = self._stations.get(node)
        return station is not None and station.position is not None

    def add_receiver(self, message: GpsReceiver) -> None:
        """Add a receiver's report, for the height of the geoid above the ellipsoid."""
        if message.geoid_height_m is not None and message.fix_type >= FIX_3D:
            self._geoid_height_m = message.geoid_height_m

    def ranged_s(self, node: int) -> float | None:
        """Return when the newest range to a station came; None where none did."""
        return self._ranged_s.get(node)

    def resolve(self, message: PeerRange) -> ResolvedRange:
        """Find the other end of a range: a vehicle, or a station whose position is known."""
        resolved = self._resolve(message)
        if resolved.message is not None and is_station(resolved.message.peer):
            self._ranged_s[resolved.message.peer] = message.received_at_s
            if self.first_ranged_s is None:
                self.first_ranged_s = message.received_at_s
        return resolved

    def _resolve(self, message: PeerRange) -> ResolvedRange:
        beacon = message.beacon
        if beacon is None:
            if not is_station(message.peer) or self.is_placed(message.peer):
                return ResolvedRange(message)
            text = f"it ranges {node_name(message.peer)}, which has no position: give it one in [[station]]"
            return self._refuse_unplaced(message, CoreRefusal.STATION_UNKNOWN, text)
        if beacon.position is None and self._beacon_ids == "vehicles":
            return self._resolve_vehicle(message, beacon)
        if beacon.position is None and not self.is_placed(message.peer):
            text = (
                f"its RANGING_BEACON of beacon {beacon.beacon_id} has no position: add a [[station]] with this id, "
                'or set ranging_beacon_ids = "vehicles" where these are system ids of vehicles'
            )
            return self._refuse_unplaced(message, CoreRefusal.BEACON_WITHOUT_POSITION, text)
        if beacon.position is None:
            return ResolvedRange(message)
        return self._resolve_station(message, beacon, beacon.position)

    def _resolve_vehicle(self, message: PeerRange, beacon: Beacon) -> ResolvedRange:
        if not is_system_id(beacon.beacon_id) or beacon.beacon_id == message.sysid:
            text = f"its RANGING_BEACON names beacon {beacon.beacon_id}, which is no other vehicle's system id"
            return self._refuse(message, CoreRefusal.BEACON_NO_VEHICLE, text)
        return ResolvedRange(replace(message, peer=beacon.beacon_id, beacon=None))

    def _resolve_station(self, message: PeerRange, beacon: Beacon, stated: BeaconPosition) -> ResolvedRange:
        known = self._stations.get(message.peer)
        placed = self._placed(stated)
        if known is not None and known.position is not None:
            if placed is None or (apart_m := _contradiction_m(known.position, placed)) is None:
                return ResolvedRange(message)
            if known.source is not StationSource.CONFIGURED:
                text = f"its RANGING_BEACON puts {known.label} {apart_m:.0f} m from where it was at first: not used"
                return self._refuse(message, CoreRefusal.STATION_CONTRADICTED, text)
            text = (
                f"its RANGING_BEACON puts {known.label} {apart_m:.0f} m from where the configuration has it: "
                "the configuration counts; correct the wrong one"
            )
            self.refused[CoreRefusal.STATION_CONTRADICTED] += 1
            return ResolvedRange(message, self._notice(message, CoreRefusal.STATION_CONTRADICTED, text))
        if placed is None:
            text = (
                f"its RANGING_BEACON of station {beacon.beacon_id} has no height above mean sea level, and no receiver tells "
                "the geoid's: send alt_type 1, or give the station's position in [[station]]"
            )
            return self._refuse(message, CoreRefusal.STATION_HEIGHT_UNKNOWN, text)
        if known is None and len(self._stations) >= MAX_STATIONS:
            return self._refuse(message, CoreRefusal.STATIONS_FULL, f"more than {MAX_STATIONS} stations are stated")
        name = known.name if known is not None else ""
        self._stations[message.peer] = Station(beacon.beacon_id, name, placed, StationSource.STATED)
        text = f"station {beacon.beacon_id} is where its RANGING_BEACON puts it: {placed.lat_deg:.7f}, {placed.lon_deg:.7f}"
        return ResolvedRange(message, Notice(message.received_at_s, message.sysid, "info", text))

    def _placed(self, stated: BeaconPosition) -> StationPosition | None:
        """Return a stated position above mean sea level, None where its height is not known."""
        if stated.alt_m is None or not (stated.is_msl or self._geoid_height_m is not None):
            return None
        alt_msl_m = stated.alt_m if stated.is_msl else stated.alt_m - (self._geoid_height_m or 0.0)
        sigma_h_m, sigma_v_m = self._default_sigmas_m
        return StationPosition(
            stated.lat_deg,
            stated.lon_deg,
            alt_msl_m,
            stated.sigma_h_m if stated.sigma_h_m is not None else sigma_h_m,
            stated.sigma_v_m if stated.sigma_v_m is not None else sigma_v_m,
        )

    def _refuse_unplaced(self, message: PeerRange, reason: CoreRefusal, text: str) -> ResolvedRange:
        station = self._stations.get(message.peer) or Station(station_id_of(message.peer))
        return self._refuse(message, reason, text)._replace(unplaced=station)

    def _refuse(self, message: PeerRange, reason: CoreRefusal, text: str) -> ResolvedRange:
        self.refused[reason] += 1
        return ResolvedRange(None, self._notice(message, reason, text))

    def _notice(self, message: PeerRange, reason: CoreRefusal, text: str) -> Notice | None:
        """Return a warning; None where it, or as many others as are kept, was given within a minute."""
        key, now_s = (reason, message.peer), message.received_at_s
        self._told = {each: told_s for each, told_s in self._told.items() if now_s - told_s < _TOLD_EVERY_S}
        if key in self._told or len(self._told) >= _MAX_TOLD:
            return None
        self._told[key] = now_s
        return Notice(now_s, message.sysid, "warning", text)


def _contradiction_m(a: StationPosition, b: StationPosition) -> float | None:
    """Return how far two positions of a station are apart, m; None where they may be one."""
    across_m = horizontal_distance_m(a.lat_deg, a.lon_deg, b.lat_deg, b.lon_deg)
    up_m = abs(a.alt_msl_m - b.alt_msl_m)
    limits_m = (
        max(_CONTRADICTS_SIGMAS * hypot(one, other), _CONTRADICTS_M)
        for one, other in ((a.sigma_h_m, b.sigma_h_m), (a.sigma_v_m, b.sigma_v_m))
    )
    return hypot(across_m, up_m) if any(apart > most for apart, most in zip((across_m, up_m), limits_m, strict=True)) else None
