"""The driver's link itself, without a flight: the test stands for the autopilot at its other end."""

from __future__ import annotations

import socket

from pilot import Pilot
from pymavlink.dialects.v20 import ardupilotmega as mavlink


def test_a_component_of_a_vector_is_confirmed_by_its_own_value():
    # ArduPilot answers with all three. The last one was held for the answer: each component took four tries, 6 s.
    pilot = Pilot(4, 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.bind(("127.0.0.1", 0))
        autopilot.setblocking(False)
        pilot.peer = autopilot.getsockname()
        asked = []
        to_driver, of_driver = mavlink.MAVLink(None, srcSystem=4, srcComponent=1), mavlink.MAVLink(None)

        def answer() -> None:
            try:
                data = autopilot.recv(4096)
            except BlockingIOError:
                return
            for message in of_driver.parse_buffer(data):
                asked.append(message.param_value)
                for axis, value in (("X", message.param_value), ("Y", 0.0), ("Z", 0.0)):
                    told = mavlink.MAVLink_param_value_message(f"SIM_GPS1_GLTCH_{axis}".encode(), value, 9, 1400, 1)
                    autopilot.sendto(told.pack(to_driver), pilot.socket.getsockname())

        pilot.while_waiting = answer
        assert pilot.set_parameter("SIM_GPS1_GLTCH_X", 0.25)
        assert asked == [0.25]
    pilot.close()
