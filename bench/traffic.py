"""Realistic traffic: a simulated fleet of four with ArduPilot's default streams; vehicle 4 is GNSS-denied and ranges the others.

ArduPilot sends each message of its telemetry streams once a second by default (SRn_* = 1). With positions at 10 Hz that makes
about 40 messages a second, of which the service has use for every second one.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.mavlink.framing import CRC_EXTRA, MESSAGE_CLASSES
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import SCENARIOS, Scenario, load_scenario

SCENARIO = SCENARIOS / "uwb.toml"
LOST = 4
WARM_S = 15.0
"""By then vehicle 4 has lost its GPS and is located, and nothing of the start is left."""
_LOST_AT_S = 5.0
_RANGE_HZ = 5.0
_LATENCY_S, _JITTER_S = 0.02, 0.02
_BESIDE_M, _ABOVE_M = 60.0, 7.0
_EVERY_SECOND = (1, 2, 24, 29, 30, 74, 124, 193)
_POSITION, _POSITION_HZ = 33, 10.0
# What an ArduPlane sends besides, taken from one: the service passes these over.
OTHERS = (62, 163, 178, 125, 152, 42, 36, 65, 27, 116, 129, 137, 168, 136, 32, 87, 147, 11020, 11030, 295, 241)
_SEED = 1


class Sent(NamedTuple):
    """One datagram: when it arrives (s), whose it is, its bytes."""

    at_s: float
    sysid: int
    payload: bytes


class FleetSize(NamedTuple):
    """How many vehicles a fleet has, and how many of them lose their GPS: 4, 8, 12, ..."""

    vehicles: int = 4
    denied: int = 1


def fleet_traffic(seconds: float, size: FleetSize = FleetSize()) -> list[Sent]:  # noqa: B008 - immutable
    """What arrives from the fleet in the first `WARM_S` and `seconds` more, in order."""
    fleet = Fleet(_scenario(size), _SEED)
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    for sysid in fleet.sysids:
        for message_id, rate_hz in ((_POSITION, _POSITION_HZ), *((other, 1.0) for other in _EVERY_SECOND)):
            interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            command = mavlink.MAVLink_command_long_message(sysid, 1, interval, 0, message_id, 1e6 / rate_hz, 0, 0, 0, 0, 0)
            fleet.deliver(sysid, command.pack(station), 0.0)
    end_s = WARM_S + seconds
    sent = [Sent(d.due_s, d.sysid, d.payload) for d in fleet.advance(end_s)]
    sent = [s for s in sent if message_id_of(s.payload) != mavlink.MAVLINK_MSG_ID_COMMAND_ACK]
    for sysid in fleet.sysids:
        for n, message_id in enumerate(OTHERS):
            frame = _filled(sysid, message_id)
            sent += [Sent(second + n / len(OTHERS), sysid, frame) for second in range(int(end_s))]
    return _numbered(sorted(sent))


def message_id_of(frame: bytes) -> int:
    """The message id of a MAVLink 2 frame."""
    return int.from_bytes(frame[7:10], "little")


def _scenario(size: FleetSize) -> Scenario:
    """The scenario's four aircraft, and copies of them beside and above; each one that loses its GPS ranges all others."""
    scenario = load_scenario(SCENARIO)
    (lost,) = scenario.fault
    denied = range(LOST, LOST * size.denied + 1, LOST)
    fleet = list(scenario.vehicle)
    for n in range(len(fleet), size.vehicles):
        first, k = scenario.vehicle[n % len(scenario.vehicle)], n // len(scenario.vehicle)
        beside = [(east_m + k * _BESIDE_M, north_m + k * _BESIDE_M) for east_m, north_m in first.waypoints]
        fleet.append(first.model_copy(update={"sysid": n + 1, "height_m": first.height_m + k * _ABOVE_M, "waypoints": beside}))
    if size != FleetSize():
        everybody = [v.sysid for v in fleet]
        others = {v.sysid: [s for s in everybody if s != v.sysid] if v.sysid in denied else [] for v in fleet}
        fleet = [v.model_copy(update={"ranges_to": others[v.sysid]}) for v in fleet]
    changes = {
        "telemetry": scenario.telemetry.model_copy(update={"latency_s": _LATENCY_S, "jitter_s": _JITTER_S, "loss": 0.0}),
        "ranging": scenario.ranging.model_copy(update={"rate_hz": _RANGE_HZ}),
        "vehicle": fleet,
        "fault": [lost.model_copy(update={"at_s": _LOST_AT_S, "vehicle": sysid}) for sysid in denied],
    }
    return scenario.model_copy(update=changes)


def _filled(sysid: int, message_id: int) -> bytes:
    """A message whose fields hold no zeros, for these would be cut off; its number and checksum are still to be set."""
    size = MESSAGE_CLASSES[message_id].unpacker.size
    payload = bytes((17 * i + sysid) % 251 + 1 for i in range(size))
    return bytes((0xFD, size, 0, 0, 0, sysid, 1)) + message_id.to_bytes(3, "little") + payload + b"\0\0"


def _numbered(sent: list[Sent]) -> list[Sent]:
    """The datagrams with each vehicle's frames numbered as they arrive, and their checksums to match."""
    counts: Counter[int] = Counter()
    out = []
    for datagram in sent:
        frame = bytearray(datagram.payload[:-2])
        frame[4] = counts[datagram.sysid] & 0xFF
        counts[datagram.sysid] += 1
        checksum = mcrf4xx(bytes(frame[1:]) + bytes((CRC_EXTRA[message_id_of(datagram.payload)],)))
        out.append(datagram._replace(payload=bytes(frame) + checksum.to_bytes(2, "little")))
    return out
