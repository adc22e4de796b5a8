"""How four vehicles of ArduPilot's SITL fly a case: missions up, armed, on their way, then the fault and what follows."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from flown_place import MissionItem, mission, place
from four_ship import Case, FourShip, in_flight
from pilot import Pilot
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from simulators import ORIGIN_ALT_M, Simulator, ardupilot

_WANTED_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_SIM_STATE: 25.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
}
_ON_THEIR_WAY_S = 50.0
_READY_S = 150.0


@dataclass(frozen=True)
class ArduPilotFlight:
    """How four vehicles of one kind fly a case: simulator's model, parameters, the number of AUTO, half the mission's sides.

    A case begins some time after all are `climbed_m` above their homes; None for vehicles on the ground.
    """

    model: str
    parameters: Mapping[str, float]
    auto_mode: int
    half_sides_m: tuple[float, float]
    mission: Callable[[int, float, float], list[MissionItem]] = mission
    climbed_m: float | None = 70.0
    announced_delay_s: float = 0.1
    """GPS2_DELAY_MS of the guide: what the service sends is judged for this age."""

    def fly(self, case: Case, program: Path, directory: Path) -> FourShip:
        """Missions up, armed, on their way, then the fault and what follows. Returns when all is over."""
        parameters = {**self.parameters, **case.parameters}
        if case.starts_in_flight:
            parameters["GPS2_TYPE"] = 0  # with 14 and no stream it does not arm

        def start(sysid: int, service_port: int, driver_port: int) -> Simulator:
            where = directory / f"vehicle{sysid}"
            return ardupilot(program, self.model, sysid, place(sysid), service_port, driver_port, where, parameters)

        with in_flight(case, directory, start) as ship:
            pilots = ship.pilots.values()
            ship.wait("heartbeats", lambda: all("HEARTBEAT" in p.latest for p in pilots), 60.0)
            for pilot in pilots:
                for message_id, rate_hz in _WANTED_HZ.items():
                    assert pilot.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz) == 0
                pilot.upload(self.mission(pilot.sysid, *self.half_sides_m))
            for pilot in pilots:
                self._arm(ship, pilot)
            if (above_m := self.climbed_m) is not None:
                ship.wait("climb", lambda: all(p.truth and p.truth[-1].alt_m > ORIGIN_ALT_M + above_m for p in pilots))
            ship.run(_ON_THEIR_WAY_S)
            if case.starts_in_flight:
                for pilot in pilots:
                    assert pilot.set_parameter("GPS2_TYPE", 14)
                ship.start_service()
            ship.befall()
        return ship

    def _arm(self, ship: FourShip, pilot: Pilot) -> None:
        ends_s = time.monotonic() + _READY_S
        while True:
            pilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1, self.auto_mode)
            if pilot.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == 0:
                return
            if time.monotonic() > ends_s:
                raise TimeoutError(f"vehicle {pilot.sysid} does not arm: {[text for _, text in pilot.texts[-6:]]}")
            ship.run(2.0)
