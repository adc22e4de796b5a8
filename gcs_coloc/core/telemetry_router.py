"""What each kind of message of a vehicle does: to the vehicle's record, as evidence of its GPS, and as a measurement."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from gcs_coloc.core.aiding.aiding import Aiding
from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.integrity.monitor import IntegrityMonitor
from gcs_coloc.core.messages.aiding import CommandResult, ParameterValue
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    EkfStatus,
    FromVehicle,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    PeerRange,
    SystemHealth,
    SystemTime,
    TimeSyncAnswer,
)
from gcs_coloc.core.messages.outbound import Notice, Outbound
from gcs_coloc.core.telemetry.measurement_builder import MeasurementBuilder
from gcs_coloc.core.telemetry.vehicles import Vehicle, VehicleRegistry


class Telemetry:
    """Takes the messages of one fleet's vehicles. `tell` is given what is to be sent or told; `refused` counts refusals."""

    def __init__(
        self,
        fleet: VehicleRegistry,
        feed: MeasurementBuilder,
        aiding: Aiding,
        integrity: IntegrityMonitor,
        estimator: Estimator,
        tell: Callable[[Outbound], None],
    ) -> None:
        self.refused: Counter[str] = Counter()
        self._fleet = fleet
        self._feed = feed
        self._aiding = aiding
        self._integrity = integrity
        self._estimator = estimator
        self._tell = tell
        # By the message's own class: the way of every message is one look-up. Each says whether the vehicle is to be reviewed.
        self._takers: dict[type[Any], Callable[[Any, Vehicle], bool]] = {
            GlobalPosition: self._position,
            Attitude: self._attitude,
            PeerRange: self._range,
            SystemTime: self._system_time,
            TimeSyncAnswer: self._time_answer,
            Airspeed: self._airspeed,
            Heartbeat: self._heartbeat,
            GpsReceiver: self._receiver,
            SystemHealth: self._evidence,
            EkfStatus: self._evidence,
            CommandResult: self._command_result,
            ParameterValue: self._parameter,
        }

    def take(self, message: FromVehicle, vehicle: Vehicle) -> bool:
        """Take one message of a vehicle; True where its health and its aid are to be reviewed for it."""
        return self._takers[type(message)](message, vehicle)

    def _position(self, message: GlobalPosition, vehicle: Vehicle) -> bool:
        vehicle.position = message
        measurement = self._feed.position(message, vehicle)
        if vehicle.claim is not None:
            vehicle.health.motion.take_claim(vehicle.claim, own=not vehicle.health.aided)
            self._integrity.add_position(vehicle.claim, vehicle.health.state, is_aided=vehicle.health.aided)
        if measurement is not None:
            vehicle.delay_s = measurement.arrived_at_s - measurement.measured_at_s
            self._estimator.add(measurement)
        return False

    def _attitude(self, message: Attitude, vehicle: Vehicle) -> bool:
        vehicle.attitude = message
        measurement = self._feed.attitude(message, vehicle)
        if measurement is not None:
            self._estimator.add(measurement)
        return False

    def _range(self, message: PeerRange, vehicle: Vehicle) -> bool:
        pair = (message.peer_sysid, message.device_id)
        stuck = pair in vehicle.range_repeats.stuck
        measurement = self._feed.range(message, vehicle, self._fleet.get(message.peer_sysid))
        if stuck != (pair in vehicle.range_repeats.stuck):
            self._tell_of_device(message, was_stuck=stuck)
        if measurement is not None:
            self._integrity.add_range(measurement)
            self._estimator.add(measurement)
        return False

    def _tell_of_device(self, message: PeerRange, *, was_stuck: bool) -> None:
        device, at_s = f"its ranging device {message.device_id}", message.received_at_s
        if was_stuck:
            self._tell(Notice(at_s, message.sysid, "info", f"{device} measures {message.peer_sysid} again"))
        else:
            text = f"{device} repeats one value, {message.range_m:.2f} m to {message.peer_sysid}: it is stuck and not used"
            self._tell(Notice(at_s, message.sysid, "warning", text))

    def _system_time(self, message: SystemTime, vehicle: Vehicle) -> bool:
        vehicle.utc_minus_service_s = self._feed.utc_minus_service_s(message, vehicle)
        return False

    def _time_answer(self, message: TimeSyncAnswer, vehicle: Vehicle) -> bool:
        refusal = vehicle.clock.answered(message.ts1_ns, message.tc1_ns / 1e9, message.received_at_s)
        if refusal is not None:
            self.refused[f"TIMESYNC: answer {refusal}"] += 1
        return False

    def _airspeed(self, message: Airspeed, vehicle: Vehicle) -> bool:
        vehicle.airspeed = message
        return False

    def _heartbeat(self, message: Heartbeat, vehicle: Vehicle) -> bool:
        changed = vehicle.autopilot is not message.autopilot
        vehicle.autopilot, vehicle.winged = message.autopilot, message.winged
        return changed

    def _receiver(self, message: GpsReceiver, vehicle: Vehicle) -> bool:
        if message.receiver == vehicle.health.own_receiver:
            vehicle.receiver = message
            vehicle.health.own_fix.take(message, vehicle.position)
            vehicle.receiver_fix = None if vehicle.health.trusted else self._feed.receiver_fix(message, vehicle)
        elif message.receiver == self._aiding.settings.gps_id:
            self._aiding.fed(message)
        return self._evidence(message, vehicle)

    def _evidence(self, message: GpsReceiver | SystemHealth | EkfStatus, vehicle: Vehicle) -> bool:
        vehicle.health.take(message)
        return True

    def _command_result(self, message: CommandResult, vehicle: Vehicle) -> bool:  # noqa: ARG002 - it names its vehicle itself
        for output in self._aiding.answered(message):
            self._tell(output)
        return False

    def _parameter(self, message: ParameterValue, vehicle: Vehicle) -> bool:  # noqa: ARG002 - it names its vehicle itself
        for output in self._aiding.parameter(message):
            self._tell(output)
        return False
