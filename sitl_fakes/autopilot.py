"""What every autopilot does: navigate on its estimate and steer along its route.

How positions come in is each kind's own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

from sitl_fakes.geodesy import Vector
from sitl_fakes.guidance import Guidance, heading_for_course
from sitl_fakes.navigation import HeightFilter, Navigation
from sitl_fakes.receivers import GpsFix, Receiver
from sitl_fakes.sensors import AirData

Horizontal = tuple[float, float]
"""East and north: m, or m/s."""

DEAD_RECKONING, NO_POSITION = "dead_reckoning", "none"
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
"""MAV_RESULT of a COMMAND_ACK."""
_SOURCE_HOLDS_S = 1.0  # chosen: some fixes missed


class BeaconRange(NamedTuple):
    """A range (m, 1-sigma m) to a place (east, north, m) `below_m` below the aircraft.

    `stamp_s` is when it was measured by the autopilot's boot clock, `age_s` how long ago that was.
    """

    there_m: tuple[float, float]
    below_m: float
    range_m: float
    sigma_m: float
    stamp_s: float
    age_s: float


class Autopilot(ABC):
    """One vehicle's autopilot since its last boot. Parameters and the place on the route outlive it.

    `receivers` are its two GPS ports, `in_use` the number of the one it navigates on. `lanes` are the filters that it runs side
    by side, `lane` the number of the one it goes by. `armed` is settled by whoever boots it. `origin_m` (east, north, up) is that
    of a PX4's local frame, once it has one.
    """

    def __init__(self, lanes: tuple[Navigation, ...], guidance: Guidance) -> None:
        self.receivers = (Receiver(), Receiver())
        self.in_use = 0
        self.lanes = lanes
        self.lane = 0
        self.height = HeightFilter()
        self.had_gps_time = False
        self.origin_m: Vector | None = None
        self.armed = True
        self._guidance = guidance
        self._heading_to_hold: float | None = None
        self._last_used = "gps1"
        self._to_say: list[tuple[int, str]] = []

    @property
    def navigation(self) -> Navigation:
        """The filter that it goes by."""
        return self.lanes[self.lane]

    def believed(self, at_s: float) -> tuple[Horizontal, Horizontal] | None:  # noqa: ARG002 - ArduPilot's choice needs it
        """The position (m) and velocity (m/s) that it flies by and reports; None before the first fix."""
        navigation = self.navigation
        return None if navigation.position_m is None else (navigation.position_m, navigation.velocity_mps)

    def gps_glitching(self, at_s: float) -> bool:  # noqa: ARG002 - ArduPilot's flag has a memory
        """The flag of its filter's status that says so."""
        return self.navigation.refusing

    def announcements(self) -> list[tuple[int, str]]:
        """Take out what it has to say since it was last asked: severities and texts of STATUSTEXT."""
        said, self._to_say = self._to_say, []
        return said

    @abstractmethod
    def receive_own_fix(self, fix: GpsFix, at_s: float) -> None:
        """Take a message of the aircraft's own receiver."""

    # Each kind takes some of what follows, and passes over the rest.

    def receive_gps_input(self, gps_id: int, fix: GpsFix, at_s: float) -> None:  # noqa: B027
        """Take a GPS_INPUT."""

    def receive_global_position(self, sensor_id: int, position_m: tuple[float, float], eph_m: float, at_s: float) -> None:  # noqa: B027
        """Take a GLOBAL_POSITION_SENSOR: position east and north (m) with its standard deviation (m)."""

    def receive_vision(self, position_m: tuple[float, float], variance_m2: float, at_s: float) -> None:  # noqa: B027
        """Take a VISION_POSITION_ESTIMATE.

        Position east and north (m), the larger of its two variances (m^2, NaN unknown).
        """

    def receive_range(self, beacon: BeaconRange, at_s: float) -> None:  # noqa: B027
        """Take a RANGING_BEACON."""

    @abstractmethod
    def apply_external_estimate(
        self, position_m: tuple[float, float], accuracy_m: float | None, age_s: float, at_s: float
    ) -> int:
        """Take MAV_CMD_EXTERNAL_POSITION_ESTIMATE and return its MAV_RESULT.

        `position_m` is east and north. `accuracy_m` is 1-sigma, None where unknown. `age_s` is how old the position is.
        """

    def use_own_gps(self, *, used: bool) -> int:  # noqa: ARG002 - PX4 has a choice
        """Take MAV_CMD_ESTIMATOR_SENSOR_ENABLE of the own GPS; returns MAV_RESULT."""
        return UNSUPPORTED

    @abstractmethod
    def arming_refusal(self, at_s: float) -> str | None:
        """The pre-arm failure in the autopilot's own text, None where it arms."""

    @abstractmethod
    def injected_refusal(self, at_s: float) -> str | None:
        """Why positions from outside are not used now, or None where they are fit."""

    @abstractmethod
    def gps_healthy(self, at_s: float) -> bool:
        """The GPS bit of SYS_STATUS."""

    def uses_global_position(self, at_s: float) -> bool:
        """Whether what it navigates on is a global position."""
        return self.source(at_s) not in (NO_POSITION, DEAD_RECKONING)

    def own_gps_in_use(self, at_s: float) -> bool:
        """Whether the aircraft's own receiver is the one in use, and used."""
        return self.source(at_s) == "gps1"

    def heading_command_rad(self, air: AirData, at_s: float, step_s: float) -> float:
        """Carry the estimate over one step and return the heading to fly, rad.

        Without a position the present heading is held.
        """
        for lane in self.lanes:
            lane.predict(air.airspeed_mps, air.heading_rad, step_s)
        self.height.predict(air.climb_mps, step_s)
        believed = self.believed(at_s)
        if believed is None:
            if self._heading_to_hold is None:
                self._heading_to_hold = air.heading_rad
            return self._heading_to_hold
        course = self._guidance.course_command_rad(believed[0], step_s)
        return heading_for_course(course, air.airspeed_mps, *self.navigation.wind_mps)

    def source(self, at_s: float) -> str:
        """Return the name of what it navigates on.

        One of "gps1", "gps2", "gps1 injected", "gps2 injected", "aux global position", "vision position", "ranging beacons",
        "dead_reckoning" and "none".
        """
        if self.navigation.position_m is None:
            return NO_POSITION
        return DEAD_RECKONING if self.navigation.since_position_s(at_s) > _SOURCE_HOLDS_S else self._last_used
