"""Classes of vehicles and what they can do: the motion prior of an estimator where measurements do not show the motion."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class VehicleClass(StrEnum):
    """A class of vehicles that move alike."""

    PLANE = "plane"
    MULTIROTOR = "multirotor"
    GROUND = "ground"
    BOAT = "boat"
    INDOOR = "indoor"
    """Whatever moves inside a building: small multirotors, robots, a person."""
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """The most that a vehicle does: speed and acceleration, horizontal, and climb rate."""

    max_speed_mps: float
    max_acceleration_mps2: float
    max_climb_mps: float

    def reach_m(self, since_s: float) -> float:
        """Return how far a vehicle may be from where its known velocity leads, m: min(a t^2 / 2, 2 V t)."""
        return min(0.5 * self.max_acceleration_mps2 * since_s * since_s, 2.0 * self.max_speed_mps * since_s)


LIMITS = {
    # Chosen: small aircraft up to 25 kg; a level turn at 45 degrees of bank is 1 g.
    VehicleClass.PLANE: MotionLimits(40.0, 9.8, 8.0),
    # Chosen: ArduCopter's WPNAV_SPEED goes to 20 m/s, its lean angle of 30 to 45 degrees to 1 g.
    VehicleClass.MULTIROTOR: MotionLimits(20.0, 9.8, 5.0),
    # Chosen: a rover on tyres outdoors.
    VehicleClass.GROUND: MotionLimits(10.0, 3.0, 1.0),
    # Chosen: an unmanned surface vessel.
    VehicleClass.BOAT: MotionLimits(15.0, 2.0, 0.5),
    # Chosen: a room is crossed in seconds, and a small multirotor stops within a metre.
    VehicleClass.INDOOR: MotionLimits(3.0, 5.0, 2.0),
    # Chosen: covers all of the above but fast planes.
    VehicleClass.UNKNOWN: MotionLimits(30.0, 9.8, 5.0),
}
"""What vehicles of each class can do."""
