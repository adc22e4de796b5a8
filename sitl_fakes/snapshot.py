"""What a vehicle's telemetry is made from, at one moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sitl_fakes.autopilot import Autopilot
from sitl_fakes.dynamics import FlightState
from sitl_fakes.geodesy import Vector, WorldFrame
from sitl_fakes.parameters import Kind
from sitl_fakes.sensors import AirData


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One vehicle at one moment: its clocks, its autopilot, its air data, and the truth (for the simulator's own messages alone).

    `fixed_boot_s` is the boot time of each receiver's last fix, None where there was none. `altitude_m` and `climb_mps` are
    the barometric ones.
    """

    kind: Kind
    at_s: float
    boot_s: float
    fixed_boot_s: tuple[float | None, float | None]
    unix_s: float | None
    frame: WorldFrame
    home_alt_m: float
    global_position: Literal["raw", "filtered"]
    autopilot: Autopilot
    second_receiver: bool
    air: AirData
    climb_mps: float
    true_state: FlightState
    true_velocity_mps: Vector
    true_lla: Vector

    def reported_position(self) -> tuple[Vector, Vector] | None:
        """Position (lat deg, lon deg, alt m) and velocity (east, north, up; m/s) that the vehicle reports as its own; None
        before the first fix.
        """
        position, velocity = self.autopilot.navigation.position_m, self.autopilot.navigation.velocity_mps
        if position is None:
            return None
        receiver = self.autopilot.receivers[self.autopilot.in_use]
        if self.global_position == "raw" and self.autopilot.own_gps_in_use(self.at_s):
            assert receiver.fix is not None
            assert receiver.fixed_at_s is not None
            age = self.at_s - receiver.fixed_at_s
            (east, north, _), (ve, vn, _) = receiver.fix.position_enu_m, receiver.fix.velocity_enu_mps
            position, velocity = (east + ve * age, north + vn * age), (ve, vn)
        return self.frame.to_lla_at(*position, self.air.altitude_m), (*velocity, self.climb_mps)
