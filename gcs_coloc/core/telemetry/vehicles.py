"""Who is there and what each last said: one record per vehicle, a bounded number of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from gcs_coloc.core.clocks.sender_clock import SenderClock
from gcs_coloc.core.clocks.vehicle_clocks import VehicleClock
from gcs_coloc.core.gps_health.gps_health import GpsHealth, GpsHealthSettings
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.control import NO_HEARTBEAT_YET
from gcs_coloc.core.messages.inbound import Airspeed, Attitude, Autopilot, GlobalPosition, GpsReceiver, TimeBase
from gcs_coloc.core.telemetry.air_data import LEAST_AIRSPEED_MPS
from gcs_coloc.core.telemetry.repeated_ranges import RangeRepeats

_AIR_DATA_FRESH_S = 2.0


class FixSent(NamedTuple):
    """A fix that was sent to a vehicle: when (service time, s), and the 1-sigma of its height, m."""

    at_s: float
    sigma_v_m: float


@dataclass(slots=True)
class Vehicle:
    """One vehicle as last heard. Times are on the service's clock, in seconds.

    `blocked` says why nothing can be sent to it. `range_error_m` is the 1-sigma of its ranges of late, with the errors of its
    peers' positions in it. `range_misfit` is the median NIS of those of the last seconds, its own and to it; `range_jump_m` is by
    what length all that it measures have just come to be off. `last_known_enu_m` is where the estimator last had it (east,
    north). `delay_s` is how much longer its newest position was on the way (beyond what is assumed, where TIMESYNC is not
    answered). `winged` says that it flies along its nose and turns by banking. `utc_minus_service_s` is UTC as it last told it.
    `fix_sent` is the last fix that it was sent by us, `height_told_at_s` when it last told its height, `height_datum_sigma_m` how
    uncertain that is beyond its barometer, where it began with a fix of ours. `receiver_fix` is what its receiver says while
    that is not believed. `range_repeats` knows which of its ranges are stuck.
    """

    sysid: int
    health: GpsHealth
    first_heard_s: float
    last_heard_s: float
    autopilot: Autopilot | None = None
    winged: bool = False
    blocked: str | None = NO_HEARTBEAT_YET
    position: GlobalPosition | None = None
    receiver: GpsReceiver | None = None
    airspeed: Airspeed | None = None
    attitude: Attitude | None = None
    delay_s: float | None = None
    range_error_m: float | None = None
    range_misfit: float | None = None
    range_jump_m: float | None = None
    last_known_enu_m: tuple[float, float] | None = None
    claim: PositionMeasurement | None = None
    receiver_fix: PositionMeasurement | None = None
    utc_minus_service_s: float | None = None
    fix_sent: FixSent | None = None
    height_told_at_s: float | None = None
    height_datum_sigma_m: float = 0.0
    clock: VehicleClock = field(default_factory=VehicleClock)
    range_clocks: dict[tuple[TimeBase, int], SenderClock] = field(default_factory=dict)
    range_repeats: RangeRepeats = field(default_factory=RangeRepeats)

    def has_air_data(self, now_s: float) -> bool:
        """Whether it tells by airspeed and bank how it moves through the air: on wings, fast enough for them, and lately."""
        air, attitude = self.airspeed, self.attitude
        if not self.winged or air is None or attitude is None or air.airspeed_mps < LEAST_AIRSPEED_MPS:
            return False
        return now_s - min(air.received_at_s, attitude.received_at_s) <= _AIR_DATA_FRESH_S


class VehicleRegistry:
    """The registry of vehicles. A vehicle is added when it is first heard; `most` bounds how many there can be.

    `own_receiver` is the instance of the receiver that is a vehicle's own and not fed by us.
    """

    def __init__(self, health_settings: GpsHealthSettings, most: int, own_receiver: int = 0) -> None:
        self._health_settings = health_settings
        self._own_receiver = own_receiver
        self._most = most
        self._vehicles: dict[int, Vehicle] = {}

    def add(self, sysid: int, at_s: float) -> Vehicle | None:
        """A new record for a vehicle that was heard for the first time; None where the registry is full."""
        if len(self._vehicles) >= self._most:
            return None
        vehicle = Vehicle(sysid, GpsHealth(self._health_settings, self._own_receiver), at_s, at_s)
        self._vehicles[sysid] = vehicle
        return vehicle

    def get(self, sysid: int) -> Vehicle | None:
        """The record of a vehicle, or None where it was never heard."""
        return self._vehicles.get(sysid)

    def __iter__(self) -> Iterator[Vehicle]:
        return iter(self._vehicles.values())

    def __len__(self) -> int:
        return len(self._vehicles)
