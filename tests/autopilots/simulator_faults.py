"""What befalls a vehicle in these flights, by the parameters of ArduPilot's SITL."""

from __future__ import annotations

import math
import time

from four_ship import FourShip
from simulators import ORIGIN_LAT_DEG

_METRES_PER_DEGREE = 111_319.49
"""As ArduPilot's SITL counts a degree."""

_RAMP_HZ = 5.0


def lose_gps(ship: FourShip) -> None:
    """The receivers of the denied vehicles have no fix."""
    for sysid in ship.case.denied:
        ship.pilots[sysid].set_parameter("SIM_GPS1_ENABLE", 0)
        ship.event(sysid, "gps loss begins")


def jam(ship: FourShip) -> None:
    """The receivers of the denied vehicles are jammed: they flicker and wander."""
    for sysid in ship.case.denied:
        ship.pilots[sysid].set_parameter("SIM_GPS1_JAM", 1)
        ship.event(sysid, "gps jam begins")


def restore(ship: FourShip) -> None:
    """Every fault of this module ends."""
    for sysid in ship.case.denied:
        for name, value in (("SIM_GPS1_ENABLE", 1), ("SIM_GPS1_JAM", 0), ("SIM_GPS1_GLTCH_X", 0), ("SIM_GPS1_GLTCH_Y", 0)):
            ship.pilots[sysid].set_parameter(name, value)
        ship.event(sysid, "fault ends")


def glitch(ship: FourShip, east_m: float, north_m: float, wait: bool = True) -> None:
    """The receiver of the first denied vehicle is off by so much, with all its signs of health."""
    pilot = ship.pilots[ship.case.denied[0]]
    east_deg = east_m / (_METRES_PER_DEGREE * math.cos(math.radians(ORIGIN_LAT_DEG)))
    pilot.set_parameter("SIM_GPS1_GLTCH_X", north_m / _METRES_PER_DEGREE, wait=wait)
    pilot.set_parameter("SIM_GPS1_GLTCH_Y", east_deg, wait=wait)


def step_of_200_m(ship: FourShip) -> None:
    """A spoofer moves the position by 200 m at once, towards the north-east."""
    glitch(ship, 200.0 * math.sqrt(0.5), 200.0 * math.sqrt(0.5))
    ship.event(ship.case.denied[0], "spoof by a step of 200 m begins")


class Ramp:
    """A spoofer walks the position off towards the east."""

    def __init__(self, speed_mps: float) -> None:
        self._speed_mps = speed_mps
        self._due_s = 0.0

    def begin(self, ship: FourShip) -> None:
        """Write it down."""
        self._due_s = 0.0
        ship.event(ship.case.denied[0], f"spoof by {self._speed_mps:g} m/s begins")

    def during(self, ship: FourShip, since_s: float) -> None:
        """Walk on."""
        if since_s >= self._due_s:
            self._due_s = since_s + 1.0 / _RAMP_HZ
            glitch(ship, self._speed_mps * since_s, 0.0, wait=False)


class WrongAirspeed:
    """The pitot tubes of the denied vehicles read one value, so many seconds after the fault began."""

    def __init__(self, reads_mps: float, after_s: float) -> None:
        self._reads_mps = reads_mps
        self._due_s = after_s

    def during(self, ship: FourShip, since_s: float) -> None:
        """Let them fail when it is time."""
        if since_s >= self._due_s:
            self._due_s = math.inf
            for sysid in ship.case.denied:
                ship.pilots[sysid].set_parameter("SIM_ARSPD_FAIL", self._reads_mps)
                ship.event(sysid, f"airspeed of {self._reads_mps:g} m/s begins")


class Restart:
    """The service is killed, so many seconds after the fault began, and started again at once."""

    def __init__(self, after_s: float) -> None:
        self._due_s = after_s

    def during(self, ship: FourShip, since_s: float) -> None:
        """Kill it when it is time."""
        if since_s >= self._due_s and ship.service is not None:
            self._due_s = math.inf
            ship.killed_s.append(time.time())
            ship.service.kill()
            ship.event(ship.case.denied[0], "service killed")
            ship.start_service()


class Starts:
    """The service is killed and started again at once, so many times, so many seconds apart."""

    def __init__(self, times: int, every_s: float) -> None:
        self._left, self._every_s, self._due_s = times, every_s, every_s

    def during(self, ship: FourShip, since_s: float) -> None:
        """Kill it when it is time."""
        if since_s >= self._due_s and self._left and ship.service is not None:
            self._due_s, self._left = since_s + self._every_s, self._left - 1
            ship.service.kill()
            ship.start_service()


class WindStep:
    """The wind grows by 8 m/s, 60 s after the loss."""

    def __init__(self) -> None:
        self._done = False

    def during(self, ship: FourShip, since_s: float) -> None:
        """Let it blow."""
        if not self._done and since_s >= 60.0:
            self._done = True
            for pilot in ship.pilots.values():
                pilot.set_parameter("SIM_WIND_SPD", 14)
            ship.event(ship.case.denied[0], "wind steps by 8 m/s")
