"""From messages to measurements: frame, time and noise of everything that an estimator takes.

A vehicle's own position becomes a PositionMeasurement only while its GPS is trusted. Of any other vehicle only the barometric
altitude, the attitude and the airspeed are evidence.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import hypot
from typing import NamedTuple

from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import AltitudeMeasurement, AttitudeMeasurement, PositionMeasurement
from gcs_coloc.core.messages.inbound import FIX_3D, Attitude, GlobalPosition, GpsReceiver, PeerRange, Pressure
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.stations.stations import Station
from gcs_coloc.core.telemetry.altitude_builder import AltitudeBuilder, Barometer, KnownPlace, SentFix
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.core.telemetry.position_builder import HeightDifference, PositionJumps, receiver_position, reported_position
from gcs_coloc.core.telemetry.range_builder import BuiltRange, RangeMemory, build_range
from gcs_coloc.core.telemetry.reported_state import ReportedState, true_airspeed_mps

_AIRSPEED_FRESH_S = 2.2  # chosen: VFR_HUD every second with one lost; airspeed changes slowly


class BuiltPosition(NamedTuple):
    """The position that a vehicle reports, believed or not, and the measurement that it is evidence for."""

    reported: PositionMeasurement
    measurement: PositionMeasurement | AltitudeMeasurement | None


@dataclass(slots=True)
class _Vehicle:
    """What the builder keeps of one vehicle; the first three are what the methods of their names return."""

    reported: PositionMeasurement | None = None
    receiver_fix: PositionMeasurement | None = None
    attitude_at_s: float | None = None
    jumps: PositionJumps = field(default_factory=PositionJumps)
    heights: HeightDifference = field(default_factory=HeightDifference)
    altitudes: AltitudeBuilder = field(default_factory=AltitudeBuilder)
    ranges: RangeMemory = field(default_factory=RangeMemory)


_UNHEARD = _Vehicle()  # what is kept of a vehicle that was not heard: read, never written


class MeasurementBuilder:
    """Turns the messages of one fleet into measurements in the fleet's frame.

    `refused` counts what it refuses. `frame` is None until the first position of a vehicle with trusted GPS sets its origin, or
    a station does.
    """

    def __init__(self, settings: MeasurementSettings, clocks: FleetClocks) -> None:
        self.settings = settings
        self.frame: LocalFrame | None = None
        self.refused: Counter[CoreRefusal] = Counter()
        self._clocks = clocks
        self._vehicles: defaultdict[int, _Vehicle] = defaultdict(_Vehicle)

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one."""
        self._vehicles.pop(sysid, None)

    def reported(self, sysid: int) -> PositionMeasurement | None:
        """Return the newest position that a vehicle reported of itself, believed or not."""
        return self._vehicles.get(sysid, _UNHEARD).reported

    def receiver_fix(self, sysid: int) -> PositionMeasurement | None:
        """Return the newest 3D fix of a vehicle's own receiver while the vehicle is not trusted."""
        return self._vehicles.get(sysid, _UNHEARD).receiver_fix

    def attitude_at_s(self, sysid: int) -> float | None:
        """Return when the newest attitude with airspeed of a vehicle was measured."""
        return self._vehicles.get(sysid, _UNHEARD).attitude_at_s

    def set_origin(self, station: Station) -> None:
        """Set the fleet's origin at a station, where no vehicle has set it yet."""
        if self.frame is None and station.position is not None:
            self.frame = LocalFrame(station.position.lat_deg, station.position.lon_deg, station.position.alt_msl_m)

    def position(
        self,
        message: GlobalPosition,
        vehicle: ReportedState,
        *,
        is_trusted: bool,
        sent_fix: SentFix | None = None,
        located_enu_m: tuple[float, float] | None = None,
    ) -> BuiltPosition | None:
        """Build the position of a trusted vehicle, or the altitude of any other.

        None where its stamp is refused, or there is no frame yet. `sent_fix` is the last fix that the vehicle was sent,
        `located_enu_m` where the estimator has it (east, north).
        """
        measured = self._clocks.stamp(message)
        if measured is None:
            return None
        if self.frame is None and is_trusted:
            self.frame = LocalFrame(message.lat_deg, message.lon_deg, message.alt_msl_m)
        if self.frame is None:
            return None
        kept = self._vehicles[message.sysid]
        reported = kept.reported = reported_position(
            message, vehicle.receiver, measured, self.frame, self.settings, kept.jumps, kept.heights, is_trusted=is_trusted
        )
        if is_trusted:
            kept.altitudes.add_trusted_position(message, reported, self._barometers())
            return BuiltPosition(reported, reported)
        altitude = kept.altitudes.from_position(
            message,
            measured,
            self.frame,
            self._barometers(),
            booted_at_s=self._clocks.booted_at_s(message, measured),
            altitude_sigma_m=self._altitude_sigma_m(kept),
            sent_fix=sent_fix,
            located_enu_m=located_enu_m,
        )
        return BuiltPosition(reported, altitude)

    def pressure(
        self, message: Pressure, *, is_trusted: bool, located_enu_m: tuple[float, float] | None = None
    ) -> AltitudeMeasurement | None:
        """Build the altitude by the barometer of a vehicle that is not trusted.

        None where the vehicle is trusted, the stamp is refused, or nothing tells what the pressure means.
        """
        measured = self._clocks.stamp(message)
        if measured is None:
            return None
        kept = self._vehicles[message.sysid]
        kept.altitudes.barometer.add(message.pressure_hpa, message.received_at_s)
        if is_trusted or self.frame is None:
            return None
        return kept.altitudes.from_pressure(
            message,
            measured,
            self.frame,
            self._barometers(),
            altitude_sigma_m=self._altitude_sigma_m(kept),
            located_enu_m=located_enu_m,
        )

    def attitude(self, message: Attitude, vehicle: ReportedState) -> AttitudeMeasurement | None:
        """Build an attitude with the newest true airspeed, if that is fresh and the vehicle flies on wings.

        A multirotor, or a VTOL on its rotors, flies to any side, and banks to do so without turning: its airspeed says nothing of
        its course.
        None where it only repeats the one before, or its stamp is refused.
        """
        measured = self._clocks.stamp(message)
        if measured is None:
            return None
        if vehicle.attitude is not message:
            self.refused[CoreRefusal.ATTITUDE_REPEATED] += 1
            return None
        air = vehicle.airspeed
        fresh = vehicle.on_wings and air is not None and message.received_at_s - air.received_at_s <= _AIRSPEED_FRESH_S
        if fresh:
            self._vehicles[message.sysid].attitude_at_s = measured.at_s
        return AttitudeMeasurement(
            vehicle=message.sysid,
            measured_at_s=measured.at_s,
            arrived_at_s=message.received_at_s,
            roll_rad=message.roll_rad,
            pitch_rad=message.pitch_rad,
            yaw_rad=message.yaw_rad,
            airspeed_mps=true_airspeed_mps(air.airspeed_mps, self._alt_msl_m(vehicle)) if air is not None and fresh else None,
        )

    def range(self, message: PeerRange, vehicle: ReportedState, peer: ReportedState | Station | None) -> BuiltRange:
        """Build a range of a vehicle to a vehicle or station; `peer` is None where that was never heard."""
        if peer is None:
            self.refused[CoreRefusal.RANGE_PEER_UNKNOWN] += 1
            return BuiltRange(None)
        measured = self._clocks.range_time(message, self.delay_s(message.sysid))
        if measured is None:
            return BuiltRange(None)
        own = self._vehicles[message.sysid]
        if isinstance(peer, Station):
            built = build_range(message, (vehicle, own.ranges), peer, measured, self.settings)
            if built.measurement is not None:
                own.altitudes.add_range(message, self._station_place(peer, message.received_at_s))
        else:
            other = self._vehicles[peer.sysid]
            built = build_range(message, (vehicle, own.ranges), (peer, other.ranges), measured, self.settings)
            if built.measurement is not None:
                own_place, peer_place = (each.altitudes.recent_place(message.received_at_s) for each in (own, other))
                other.altitudes.add_range(message, own_place)
                own.altitudes.add_range(message, peer_place)
        if built.refused is not None:
            self.refused[built.refused] += 1
        return built

    def add_receiver(self, message: GpsReceiver, vehicle: ReportedState, *, is_trusted: bool) -> None:
        """Add a report of a vehicle's own receiver.

        While the vehicle is not trusted, `receiver_fix` returns its fix as a measurement.
        """
        fix: PositionMeasurement | None = None
        if not is_trusted and self.frame is not None and message.fix_type >= FIX_3D:
            measured = self._clocks.fix_time(message)
            fix = receiver_position(message, vehicle.position, measured, self.frame, self.settings)
        self._vehicles[message.sysid].receiver_fix = fix

    def delay_s(self, sysid: int) -> float | None:
        """Return how long the newest position was under way beyond what is assumed, s."""
        reported = self.reported(sysid)
        return reported.arrived_at_s - reported.measured_at_s if reported is not None else None

    def height_sigma_m(self, sysid: int, now_s: float) -> float:
        """Return the 1-sigma of the heights that a trusted vehicle would have without its GPS, m."""
        kept = self._vehicles.get(sysid, _UNHEARD)
        return kept.altitudes.sigma_m(now_s, self._barometers(), altitude_sigma_m=self._altitude_sigma_m(kept))

    def range_sigma_m(self, sysid: int) -> float | None:
        """Return the 1-sigma of a vehicle's ranges of late, with the errors of its peers' positions in it, m."""
        return self._vehicles.get(sysid, _UNHEARD).ranges.sigma_m

    def _altitude_sigma_m(self, kept: _Vehicle) -> float:
        """Return the 1-sigma of heights, m: the barometer's, and by how far it and the receiver last differed."""
        return hypot(self.settings.altitude_sigma_m, kept.heights.last_m)

    def _barometers(self) -> Iterator[Barometer]:
        return (kept.altitudes.barometer for kept in self._vehicles.values())

    def _station_place(self, station: Station, now_s: float) -> KnownPlace | None:
        where = station.measurement(self.frame, now_s) if self.frame is not None else None
        return KnownPlace(*where.position_enu_m[:2], 0.0, now_s, 0.0) if where is not None else None

    def _alt_msl_m(self, vehicle: ReportedState) -> float:
        """Return the altitude of a vehicle; that of the fleet's origin, or sea level, where it reports none."""
        if vehicle.position is not None:
            return vehicle.position.alt_msl_m
        return self.frame.height_m if self.frame is not None else 0.0
