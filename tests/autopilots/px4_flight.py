"""How four PX4 quadrotors or airplanes of SIH fly a case: take-off, orbits, the receiver off by PX4's own failure injection."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from flown_place import HEIGHT_M, place
from four_ship import Case, FourShip, in_flight
from pilot import Pilot
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from simulators import ORIGIN_ALT_M, px4

# Ports that PX4's own start-up script gives to its instances (px4-rc.mavlinksim): ground station, onboard, truth of SIH.
_GROUND_STATION_PORT, _ONBOARD_PORT, _TRUTH_PORT = 14550, 14540, 19410
_GPS_UNIT, _FAILURE_NONE, _FAILURE_OFF, _FAILURE_STUCK = 4, 0, 1, 2
"""FAILURE_UNIT_SENSOR_GPS; FAILURE_TYPE_OK, _OFF, _STUCK."""

_INJECT_FAILURE, _NAN = 420, float("nan")
_ORBIT_SPEED_MPS, _ORBIT_RADIUS_M = 6.0, 60.0
"""Of a quadrotor."""

_LOITER_RADIUS_M, _CLIMBS_OUT_M, _CLIMBS_OUT_TO_M = 150.0, 400.0, 50.0
"""Of an airplane: it climbs out straight to the north, where its nose points."""

_AUTO, _MISSION = 4, 4
"""PX4's main mode and its sub-mode."""

_READY_S = 120.0
_EKF2_STARTS_S, _AT_REST_S = 12.0, 20.0
"""EKF2 has no absolute position in its first seconds; then EKF2 and the service see the vehicles at rest."""

GUIDE: Mapping[str, float] = {
    "EKF2_AGP0_CTRL": 1,
    "EKF2_AGP0_ID": 1,
    "EKF2_AGP0_DELAY": 0,
}
DIRECT = "[senders]\ncompanions_elsewhere = true"
"""PX4 forwards no message that it does not know: the companion computer sends its ranges to the service itself."""

_DRIVER: Mapping[str, float] = {
    "SYS_FAILURE_EN": 1,
    "COM_RC_IN_MODE": 4,  # no transmitter
    "NAV_RCL_ACT": 0,
    "NAV_DLL_ACT": 0,
    "COM_DISARM_PRFLT": -1,
}
_WIND: Mapping[str, float] = {"SIH_WIND_N": 3.0, "SIH_WIND_E": -5.0}
"""After the climb: on the ground it would blow an airplane of 0.3 kg away, and EKF2 takes no GPS that moves there."""


@dataclass(frozen=True)
class Px4Flight:
    """Quadrotors, and the parameters of the guide; set before the boot, since PX4 reads some of them then only."""

    parameters: Mapping[str, float]
    announced_delay_s: float = 0.0
    """GLOBAL_POSITION_SENSOR is stamped on arrival."""

    model: ClassVar[str] = "sihsim_quadx"
    height_share: ClassVar[float] = 1 / 3
    """Of the heights of the place: the lower, the sooner the fault can begin."""

    def fly(self, case: Case, program: Path, directory: Path) -> FourShip:
        """On the ground for a while, up, into orbits, then the fault and what follows. Returns when all is over."""
        parameters = {**_DRIVER, **self.parameters, **case.parameters}

        def start(sysid: int, _service_port: int, _driver_port: int):
            return px4(program, self.model, sysid, place(sysid), directory / f"vehicle{sysid}", parameters)

        ports = {"service_port": _GROUND_STATION_PORT, "pilot_port": lambda sysid: _ONBOARD_PORT + sysid - 1}
        with in_flight(
            case, directory, start, truth_port=lambda sysid: _TRUTH_PORT + sysid - 1, ranges_direct=True, **ports
        ) as ship:
            pilots = ship.pilots.values()
            ship.wait("heartbeats", lambda: all("HEARTBEAT" in p.latest for p in pilots), 60.0)
            ship.run(_EKF2_STARTS_S)
            ship.ready_s = time.time()
            ship.run(_AT_REST_S)
            for pilot in pilots:
                pilot.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS, 2e5)
                self._take_off(ship, pilot)
            ship.wait("climb", lambda: all(p.truth and p.truth[-1].alt_m > self._altitude_m(p.sysid) - 5.0 for p in pilots))
            for pilot in pilots:
                for name, value in _WIND.items():
                    assert pilot.set_parameter(name, value)
                self._orbit(pilot)
            ship.run(30.0)
            ship.befall()
        return ship

    def _take_off(self, ship: FourShip, pilot: Pilot) -> None:
        ends_s = time.monotonic() + _READY_S
        while time.monotonic() < ends_s:
            if self._is_to_take_off(pilot) and pilot.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0:
                return
            ship.run(2.0)
        raise TimeoutError(f"vehicle {pilot.sysid} does not arm: {[text for _, text in pilot.texts[-6:]]}")

    def _is_to_take_off(self, pilot: Pilot) -> bool:
        """Choose the mode that takes off once it is armed; whether the vehicle has it."""
        where, altitude_m = place(pilot.sysid), self._altitude_m(pilot.sysid)
        pilot.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, _NAN, where.lat_deg, where.lon_deg, altitude_m)
        return True

    def _orbit(self, pilot: Pilot) -> None:
        where, altitude_m = place(pilot.sysid), self._altitude_m(pilot.sysid)
        circle = (_ORBIT_RADIUS_M, _ORBIT_SPEED_MPS, 0.0, 0.0)
        pilot.command_int(mavlink.MAV_CMD_DO_ORBIT, circle, where.lat_deg, where.lon_deg, altitude_m)

    def _altitude_m(self, sysid: int) -> float:
        return ORIGIN_ALT_M + HEIGHT_M[sysid] * self.height_share


class Px4AirplaneFlight(Px4Flight):
    """Airplanes: thrown rather than rolling, their mission a climb straight ahead and a loiter about their place."""

    model: ClassVar[str] = "sihsim_airplane"
    height_share: ClassVar[float] = 1.0

    def _is_to_take_off(self, pilot: Pilot) -> bool:
        frame, home, ahead = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, place(pilot.sysid), place(pilot.sysid, 0.0, _CLIMBS_OUT_M)
        climb = (0.0, 0.0, 0.0, _NAN)
        loiter = (0.0, 0.0, _LOITER_RADIUS_M, _NAN)
        pilot.upload(
            [
                (mavlink.MAV_CMD_NAV_TAKEOFF, frame, climb, ahead.lat_deg, ahead.lon_deg, _CLIMBS_OUT_TO_M),
                (mavlink.MAV_CMD_NAV_LOITER_UNLIM, frame, loiter, home.lat_deg, home.lon_deg, HEIGHT_M[pilot.sysid]),
            ]
        )
        return pilot.command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, _AUTO, _MISSION) == 0

    def _orbit(self, pilot: Pilot) -> None:
        """Its mission says so."""


def lose_gps(ship: FourShip) -> None:
    """The receivers of the denied vehicles are off."""
    _fail(ship, _FAILURE_OFF, "gps loss begins")


def stick_gps(ship: FourShip) -> None:
    """The receivers of the denied vehicles repeat their last fix for ever, with all its satellites."""
    _fail(ship, _FAILURE_STUCK, "gps is stuck")


def restore(ship: FourShip) -> None:
    """The receivers are on again."""
    _fail(ship, _FAILURE_NONE, "gps fault ends")


def stays_in_its_orbit(ship: FourShip) -> bool:
    """Whether the denied vehicle changed its mode at no time since the fault began."""
    return not any(at_s > ship.begins_s for at_s, _ in ship.pilots[4].modes)


def _fail(ship: FourShip, failure: int, event: str) -> None:
    for sysid in ship.case.denied:
        assert ship.pilots[sysid].command(_INJECT_FAILURE, _GPS_UNIT, failure, 0) == 0
        ship.event(sysid, event)
