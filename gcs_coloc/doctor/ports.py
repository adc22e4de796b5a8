"""A vehicle's MAVLink ports, by its parameters: which there are, and what their rates are called.

On which of them a vehicle is heard, no message tells; where there is one, it is that, unless it is USB or a network that has no
parameters of a port. Names and meanings: ArduPilot's AP_SerialManager and GCS_MAVLink of 4.5 to 4.7, PX4's MAVLink module of 1.13
to 1.16.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gcs_coloc.core.messages.inbound import Autopilot

FORWARDS_UNKNOWN = 8
"""Bit of MAVn_OPTIONS: what arrives there and ArduPilot does not know, as PEER_RANGE, is forwarded and not dropped."""
STREAMS = ("POSITION", "EXT_STAT", "EXTRA1", "EXTRA2", "EXTRA3")
"""The ends of the names of ArduPilot's stream rates that hold what we want."""

_SERIAL_PORTS = range(8)
_MAVLINK_1 = 1.0  # of SERIALn_PROTOCOL; source: ArduPilot's parameter list
_MAVLINK = (_MAVLINK_1, 2.0, 43.0)  # 43: high latency, counted as the others
_INSTANCES = range(3)
_TELEM_PORTS = {101.0: 1, 102.0: 2, 103.0: 3}

Names = tuple[str, ...]
"""A parameter under all the names that it has had, the newest first."""


@dataclass(frozen=True, slots=True)
class SerialPort:
    """ArduPilot's serial port `number` that speaks MAVLink, the `channel`-th of those that do, from 0."""

    number: int
    channel: int
    is_mavlink_1: bool

    @property
    def protocol_name(self) -> str:
        """The name of the parameter that selects the port's protocol."""
        return f"SERIAL{self.number}_PROTOCOL"

    @property
    def baud_name(self) -> str:
        """The parameter with its baud rate, in thousands."""
        return f"SERIAL{self.number}_BAUD"

    @property
    def options_name(self) -> str:
        """The parameter with its options as a MAVLink port, of ArduPilot 4.7."""
        return f"MAV{self.channel + 1}_OPTIONS"

    def rate_names(self, stream: str) -> Names:
        """The parameter with the rate of one of its streams, Hz; ArduPilot 4.7 renamed it, and counts from 1."""
        return f"MAV{self.channel + 1}_{stream}", f"SR{self.channel}_{stream}"


@dataclass(frozen=True, slots=True)
class Instance:
    """PX4's MAVLink instance `number`, which is on.

    `telem` is the number of its TELEM port; None where it is on another port.
    """

    number: int
    telem: int | None

    @property
    def rate_name(self) -> str:
        """The name of the parameter with the most that it sends, bytes per second.

        Its value 0 is half of what the port's baud rate carries.
        """
        return f"MAV_{self.number}_RATE"

    @property
    def mode_name(self) -> str:
        """The parameter that selects what it sends of itself."""
        return f"MAV_{self.number}_MODE"

    @property
    def baud_name(self) -> str | None:
        """The parameter with its port's baud rate."""
        return f"SER_TEL{self.telem}_BAUD" if self.telem is not None else None


def serial_ports(told: Mapping[str, float]) -> list[SerialPort]:
    """Return an ArduPilot's serial ports with MAVLink, as far as it has sent their parameters."""
    speaking = [n for n in _SERIAL_PORTS if told.get(f"SERIAL{n}_PROTOCOL") in _MAVLINK]
    return [SerialPort(n, channel, told[f"SERIAL{n}_PROTOCOL"] == _MAVLINK_1) for channel, n in enumerate(speaking)]


def instances(told: Mapping[str, float]) -> list[Instance]:
    """Return a PX4's MAVLink instances that are on, as far as it has sent their parameters."""
    configs = {n: told.get(f"MAV_{n}_CONFIG", 0.0) for n in _INSTANCES}
    return [Instance(n, _TELEM_PORTS.get(config)) for n, config in configs.items() if config != 0.0]


def wanted(autopilot: Autopilot, told: Mapping[str, float]) -> list[Names]:
    """Return the parameters of its ports to request, by what it has sent so far."""
    if autopilot is Autopilot.ARDUPILOT:
        ports = serial_ports(told)
        return [
            *((f"SERIAL{n}_PROTOCOL",) for n in _SERIAL_PORTS),
            *(port.rate_names(stream) for port in ports for stream in STREAMS),
            *((name,) for port in ports for name in (port.baud_name, port.options_name)),
        ]
    if autopilot is Autopilot.PX4:
        on = instances(told)
        bauds = (instance.baud_name for instance in on)
        return [
            *((f"MAV_{n}_CONFIG",) for n in _INSTANCES),
            *((name,) for instance in on for name in (instance.rate_name, instance.mode_name)),
            *((name,) for name in bauds if name is not None),
        ]
    return []
