"""One real autopilot's ground station and companion computer on a UDP port: parameters, mission, arming, truth, ranges."""

from __future__ import annotations

import math
import os
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

os.environ["MAVLINK20"] = "1"

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from simulators import COMPANION

from sitl_fakes.wire import peer_range_frame

_GROUND_STATION = 255
_ANSWER_S = 1.5
_PRESSURE_ALT_SCALE = 1000.0


@dataclass(frozen=True)
class Place3D:
    """A position at a UNIX time (s): degrees, metres above mean sea level."""

    unix_s: float
    lat_deg: float
    lon_deg: float
    alt_m: float


@dataclass
class Pilot:
    """The driver's link to one vehicle. `truth` and `believed` are the simulator's and the autopilot's positions as they came."""

    sysid: int
    port: int
    truth_port: int | None = None
    ranges_to: tuple[str, int] | None = None
    """Where ranges go, if not through the autopilot."""
    peer: tuple[str, int] | None = None
    while_waiting: Callable[[], None] = lambda: None
    """What goes on while it waits for an answer: the other vehicles' truth is stamped as it is read."""
    truth: list[Place3D] = field(default_factory=list)
    believed: list[Place3D] = field(default_factory=list)
    stated_m: list[tuple[float, float]] = field(default_factory=list)
    """The accuracy that PX4's EKF2 states of its position (ESTIMATOR_STATUS), with UNIX times."""
    texts: list[tuple[float, str]] = field(default_factory=list)
    modes: list[tuple[float, int]] = field(default_factory=list)
    latest: dict[str, Any] = field(default_factory=dict)
    told: dict[str, float] = field(default_factory=dict)
    """The parameters that it told last, by name. ArduPilot answers one component of a vector with all three."""

    def __post_init__(self) -> None:
        """Open the socket."""
        self.socket = _bound(self.port)
        self._truth_socket = None if self.truth_port is None else _bound(self.truth_port)
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True
        self._out = mavlink.MAVLink(None, srcSystem=_GROUND_STATION, srcComponent=190)
        self._sequence = 0

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
        if self._truth_socket is not None:
            self._truth_socket.close()

    def receive(self) -> list[Any]:
        """Read all that has come."""
        out = self._read(self.socket)
        if self._truth_socket is not None:
            self._read(self._truth_socket)
        return out

    def _read(self, where: socket.socket) -> list[Any]:
        out: list[Any] = []
        while True:
            try:
                data, sender = where.recvfrom(4096)
            except BlockingIOError:
                return out
            except ConnectionError:
                continue
            if where is self.socket:
                self.peer = sender
            now_s = time.time()
            for message in self._in.parse_buffer(data) or []:
                if message.get_srcSystem() == self.sysid:
                    self._keep(message, now_s)
                    out.append(message)

    def _keep(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        self.latest[kind] = message
        if kind == "PARAM_VALUE":
            self.told[message.param_id] = float(message.param_value)
        if kind == "SIM_STATE":
            self.truth.append(Place3D(now_s, message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt))
        elif kind == "HIL_STATE_QUATERNION":
            self.truth.append(Place3D(now_s, message.lat * 1e-7, message.lon * 1e-7, message.alt / _PRESSURE_ALT_SCALE))
        elif kind == "GLOBAL_POSITION_INT":
            self.believed.append(Place3D(now_s, message.lat * 1e-7, message.lon * 1e-7, message.alt / _PRESSURE_ALT_SCALE))
        elif kind == "ESTIMATOR_STATUS":
            self.stated_m.append((now_s, message.pos_horiz_accuracy))
        elif kind == "STATUSTEXT":
            self.texts.append((now_s, message.text))
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1 and [message.custom_mode] != [m for _, m in self.modes[-1:]]:
            self.modes.append((now_s, message.custom_mode))

    def send(self, message: Any) -> None:
        """Send as the ground station."""
        if self.peer is not None:
            self.socket.sendto(message.pack(self._out), self.peer)

    def heartbeat(self) -> None:
        """Say that the ground station is there."""
        self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

    def send_range(self, peer_system: int, range_m: float, sigma_m: float, measured_unix_s: float) -> None:
        """Send PEER_RANGE as the companion computer, stamped with the UNIX time of the measurement."""
        self._sequence += 1
        frame = peer_range_frame(
            sysid=self.sysid,
            compid=COMPANION,
            frame_sequence=self._sequence,
            time_usec=round(measured_unix_s * 1e6),
            peer_system=peer_system,
            range_m=range_m,
            range_std_m=sigma_m,
            sequence=self._sequence,
        )
        if (to := self.ranges_to or self.peer) is not None:
            self.socket.sendto(frame, to)

    def set_interval(self, message_id: int, rate_hz: float) -> None:
        """Request a message at a rate on this port."""
        self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)

    def command(self, number: int, *params: float) -> int | None:
        """Send a command and return its result, None where no answer came."""
        self.latest.pop("COMMAND_ACK", None)
        self._command(number, *params)
        found = self._wait(lambda: getattr(self.latest.get("COMMAND_ACK"), "command", None) == number)
        return int(self.latest["COMMAND_ACK"].result) if found else None

    def command_int(self, number: int, params: Sequence[float], lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """Send a command with a place, altitude above mean sea level."""
        x, y, frame = round(lat_deg * 1e7), round(lon_deg * 1e7), mavlink.MAV_FRAME_GLOBAL
        self.send(mavlink.MAVLink_command_int_message(self.sysid, 1, frame, number, 0, 0, *params, x, y, alt_m))

    def _command(self, number: int, *params: float) -> None:
        padded = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(self.sysid, 1, number, 0, *padded))

    def set_parameter(self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32, wait: bool = True) -> bool:
        """Set a parameter; True where the vehicle confirms it (or where it is not waited for)."""
        for _ in range(4):
            self.told.pop(name, None)
            self.send(mavlink.MAVLink_param_set_message(self.sysid, 1, name.encode(), value, kind))
            if not wait or self._wait(lambda: name in self.told):
                return True
        return False

    def parameter(self, name: str) -> float | None:
        """Read a parameter."""
        self.told.pop(name, None)
        self.send(mavlink.MAVLink_param_request_read_message(self.sysid, 1, name.encode(), -1))
        self._wait(lambda: name in self.told)
        return self.told.get(name)

    def upload(self, items: Sequence[tuple[int, int, Sequence[float], float, float, float]]) -> None:
        """Upload a mission: (command, frame, params 1 to 4, latitude deg, longitude deg, altitude m). Raises TimeoutError."""
        for _ in range(20):
            self.latest.pop("MISSION_ACK", None)
            self.send(mavlink.MAVLink_mission_count_message(self.sysid, 1, len(items), 0))
            ends_s = time.monotonic() + 5.0
            while time.monotonic() < ends_s and "MISSION_ACK" not in self.latest:
                self.while_waiting()
                for message in self.receive():
                    if message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                        self._send_item(message.seq, items[message.seq])
                time.sleep(0.005)
            if "MISSION_ACK" in self.latest and self.latest["MISSION_ACK"].type == 0:
                return
            time.sleep(1.0)  # it is still starting
        raise TimeoutError(f"vehicle {self.sysid} did not take the mission: {self.latest.get('MISSION_ACK')}")

    def _send_item(self, number: int, item: tuple[int, int, Sequence[float], float, float, float]) -> None:
        command, frame, (p1, p2, p3, p4), lat_deg, lon_deg, alt_m = item
        x, y = round(lat_deg * 1e7), round(lon_deg * 1e7)
        self.send(
            mavlink.MAVLink_mission_item_int_message(self.sysid, 1, number, frame, command, 0, 1, p1, p2, p3, p4, x, y, alt_m, 0)
        )

    def _wait(self, condition: Callable[[], bool], limit_s: float = _ANSWER_S) -> bool:
        ends_s = time.monotonic() + limit_s
        while time.monotonic() < ends_s:
            self.while_waiting()
            self.receive()
            if condition():
                return True
            time.sleep(0.003)
        return False


def _bound(port: int) -> socket.socket:
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    bound.bind(("127.0.0.1", port))
    bound.setblocking(False)
    return bound


def distance_m(a: Place3D, b: Place3D) -> float:
    """Slant range between two positions a few kilometres apart (sphere, mean latitude), m."""
    east, north = offset_m(a, b)
    return math.sqrt(east**2 + north**2 + (a.alt_m - b.alt_m) ** 2)


def offset_m(a: Place3D, b: Place3D) -> tuple[float, float]:
    """East and north of b from a, m: WGS 84 radii of curvature at the mean latitude, good to a millimetre per kilometre."""
    lat = math.radians((a.lat_deg + b.lat_deg) / 2.0)
    e2 = 6.69437999014e-3
    w = 1.0 - e2 * math.sin(lat) ** 2
    meridian_m, normal_m = 6378137.0 * (1.0 - e2) / w**1.5, 6378137.0 / math.sqrt(w)
    north = math.radians(b.lat_deg - a.lat_deg) * (meridian_m + a.alt_m)
    east = math.radians(b.lon_deg - a.lon_deg) * (normal_m + a.alt_m) * math.cos(lat)
    return east, north
