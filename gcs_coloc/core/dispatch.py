"""Message dispatch: builds what one message is evidence for, and hands it to the stages that use it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from gcs_coloc.core.aiding.aiding import Aiding
from gcs_coloc.core.aiding.methods.ranging_beacon import VettedRanges
from gcs_coloc.core.clocks.fleet_clocks import FleetClocks
from gcs_coloc.core.estimator import GuardedEstimator
from gcs_coloc.core.gps_health.gps_health import FleetGpsHealth, GpsState
from gcs_coloc.core.integrity.monitor import IntegrityMonitor
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    PositionMeasurement,
    VehicleClass,
    VehicleClassReport,
)
from gcs_coloc.core.messages.inbound import (
    Attitude,
    CommandResult,
    FromVehicle,
    GlobalOrigin,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    ParameterValue,
    PeerRange,
    Pressure,
    SystemTime,
    TimeSyncAnswer,
    VtolState,
)
from gcs_coloc.core.messages.outbound import Notice, Outbound
from gcs_coloc.core.readiness.readiness_review import RecentRanges
from gcs_coloc.core.stations.node_id import is_station
from gcs_coloc.core.stations.station_survey import StationSurvey
from gcs_coloc.core.stations.stations import Station, Stations
from gcs_coloc.core.telemetry.altitude_builder import SentFix
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder
from gcs_coloc.core.telemetry.proven_vehicles import ProvenVehicles
from gcs_coloc.core.telemetry.reported_state import ReportedState, Telemetry


class LastRound(NamedTuple):
    """What later stages found of a vehicle in the last round.

    `is_trusted`: its reported position is evidence. `is_witness`: it is in the tests of integrity. `is_aided`: it may fly on our
    fix. `sent_fix` is the last fix that it was sent, `located_enu_m` where the estimator has it (east, north).
    """

    is_trusted: bool
    is_witness: bool
    is_aided: bool
    sent_fix: SentFix | None
    located_enu_m: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Stages:
    """The stages of one fleet, in the order in which a message passes them.

    No stage holds another one, except the clocks.
    """

    telemetry: Telemetry
    proven: ProvenVehicles
    clocks: FleetClocks
    stations: Stations
    measurements: MeasurementBuilder
    estimator: GuardedEstimator
    integrity: IntegrityMonitor
    gps_health: FleetGpsHealth
    aiding: Aiding
    vetted: VettedRanges
    survey: StationSurvey
    ranges: RecentRanges = field(default_factory=RecentRanges)


class MessageDispatch:
    """Hands one message at a time to the stages that use it, and the measurement that is built from it.

    Order: telemetry and clocks -> measurement -> estimator, integrity, GPS health, aiding.
    """

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._classes: dict[int, VehicleClass] = {}

    def forget(self, sysid: int) -> None:
        """Forget a vehicle that makes room for another one, here and in every stage.

        The estimator forgets none: of one that was never proven it was told the class alone.
        """
        s = self._stages
        for stage in (s.telemetry, s.proven, s.clocks, s.measurements, s.integrity, s.gps_health, s.aiding, s.vetted, s.ranges):
            stage.forget(sysid)
        self._classes.pop(sysid, None)

    def add(self, message: FromVehicle, vehicle: ReportedState, last_round: Callable[[int], LastRound]) -> list[Outbound]:
        """Add a message of a vehicle; return what is to be sent or shown at once.

        The reported state of the vehicle holds the message already. `last_round` returns what later stages found of a vehicle.
        """
        s, sysid = self._stages, vehicle.sysid
        match message:
            # First what comes most often; no later stage has to judge it.
            case Attitude():
                self._add_measurement(s.measurements.attitude(message, vehicle))
            case PeerRange():
                return self._add_range(message, vehicle)
            case GlobalPosition():
                self._add_position(message, vehicle, last_round(sysid))
            case GpsReceiver():
                self._add_receiver(message, vehicle, last_round(sysid))
            case Pressure():
                last = last_round(sysid)
                altitude = s.measurements.pressure(message, is_trusted=last.is_trusted, located_enu_m=last.located_enu_m)
                self._add_measurement(altitude)
            case SystemTime():
                s.clocks.add_system_time(message, gps_is_trusted=last_round(sysid).is_trusted)
            case Heartbeat():
                self._add_class(sysid, message.received_at_s, message.vehicle_class, vehicle)
            case VtolState() if vehicle.winged:
                self._add_class(sysid, message.received_at_s, VehicleClass.PLANE, vehicle)
            case TimeSyncAnswer():
                s.clocks.add_answer(message)
            case CommandResult():
                return s.aiding.add_result(message)
            case GlobalOrigin():
                s.aiding.add_origin(message)
            case ParameterValue():
                return s.aiding.add_parameter(message)
        return []

    def _add_class(self, sysid: int, at_s: float, reported: VehicleClass | None, vehicle: ReportedState) -> None:
        """Tell the estimator a changed vehicle class; a VTOL on its rotors is a multirotor."""
        found = VehicleClass.MULTIROTOR if vehicle.winged and vehicle.on_rotors else reported
        if found is not None and found is not self._classes.get(sysid):
            self._classes[sysid] = found
            self._stages.estimator.add(VehicleClassReport(sysid, at_s, at_s, found))

    def _add_position(self, message: GlobalPosition, vehicle: ReportedState, last: LastRound) -> None:
        built = self._stages.measurements.position(
            message, vehicle, is_trusted=last.is_trusted, sent_fix=last.sent_fix, located_enu_m=last.located_enu_m
        )
        if built is None:
            return
        self._stages.gps_health[message.sysid].add_position(built.reported, own=not last.is_aided)
        if last.is_witness:
            self._stages.integrity.add_position(built.reported)
        self._add_measurement(built.measurement)

    def _add_measurement(self, measurement: AltitudeMeasurement | AttitudeMeasurement | PositionMeasurement | None) -> None:
        if measurement is not None and self._stages.proven.is_proven(measurement.vehicle):
            self._stages.estimator.add(measurement)

    def _add_range(self, message: PeerRange, vehicle: ReportedState) -> list[Outbound]:
        s = self._stages
        if not s.proven.is_proven(message.sysid):
            # The ranges of a vehicle that is made up would place it, and then pull at all others.
            return []
        resolved, told, unplaced = s.stations.resolve(message)
        if resolved is None:
            wrong = self._survey(message, vehicle, unplaced) if unplaced is not None else None
            return [notice for notice in (told, wrong) if notice is not None]
        to_station = is_station(resolved.peer)
        built = s.measurements.range(
            resolved, vehicle, s.stations.get(resolved.peer) if to_station else s.telemetry.get(resolved.peer)
        )
        if built.measurement is not None:
            if not to_station:
                s.proven.add_range(built.measurement, *(self._believed(sysid) for sysid in (message.sysid, resolved.peer)))
            if to_station or s.proven.is_proven(resolved.peer):
                s.integrity.add_range(built.measurement)
                if not (to_station and s.integrity.has_identified(resolved.peer)):
                    s.estimator.add(built.measurement)
                    s.ranges.add(built.measurement)
                    s.vetted.add_range(built.measurement)
        return [notice for notice in (told, built.notice) if notice is not None]

    def _survey(self, message: PeerRange, vehicle: ReportedState, station: Station) -> Notice | None:
        """Survey a station without position by a range of a healthy vehicle; return the notice on its device."""
        s = self._stages
        reported = self._believed(message.sysid)
        if reported is None:
            return None
        built = s.measurements.range(message, vehicle, station)
        if built.measurement is not None:
            s.survey.add(built.measurement, reported)
        return built.notice

    def _believed(self, sysid: int) -> PositionMeasurement | None:
        """Return the position that a vehicle reports while its GPS is healthy."""
        is_healthy = self._stages.gps_health[sysid].state is GpsState.HEALTHY
        return self._stages.measurements.reported(sysid) if is_healthy else None

    def _add_receiver(self, message: GpsReceiver, vehicle: ReportedState, last: LastRound) -> None:
        if message.receiver == self._stages.telemetry.own_receiver:
            self._stages.stations.add_receiver(message)
            self._stages.measurements.add_receiver(message, vehicle, is_trusted=last.is_trusted)
            self._stages.gps_health[message.sysid].add_receiver(message, vehicle.position)
        else:
            self._stages.aiding.add_fed_receiver(message)
