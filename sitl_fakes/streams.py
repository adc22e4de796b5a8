"""Which message is due when: the rates at which a vehicle sends its telemetry, by kind of autopilot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from sitl_fakes import telemetry
from sitl_fakes.parameters import Kind
from sitl_fakes.sensors import EPSILON_S
from sitl_fakes.telemetry import Snapshot

_Builder = Callable[[Snapshot], Any]

# Message id: (builder, default rate in Hz, 0 off).
_ARDUPILOT: dict[int, tuple[_Builder, float]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: (telemetry.heartbeat, 1.0),
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: (telemetry.sys_status, 2.0),
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: (telemetry.system_time, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: (telemetry.gps_raw_int, 5.0),
    mavlink.MAVLINK_MSG_ID_ATTITUDE: (telemetry.attitude, 10.0),
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (telemetry.global_position_int, 10.0),
    mavlink.MAVLINK_MSG_ID_VFR_HUD: (telemetry.vfr_hud, 5.0),
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: (telemetry.scaled_pressure, 0.0),
    mavlink.MAVLINK_MSG_ID_SIM_STATE: (telemetry.sim_state, 0.0),
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: (telemetry.gps2_raw, 5.0),
    mavlink.MAVLINK_MSG_ID_SIMSTATE: (telemetry.simstate, 0.0),
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: (telemetry.ekf_status_report, 2.0),
}
_ARDUPILOT_ALONE = (mavlink.MAVLINK_MSG_ID_GPS2_RAW, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
_PX4 = {
    **{number: stream for number, stream in _ARDUPILOT.items() if number not in _ARDUPILOT_ALONE},
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: (telemetry.estimator_status, 2.0),
    mavlink.MAVLINK_MSG_ID_ALTITUDE: (telemetry.altitude, 5.0),
    development.MAVLINK_MSG_ID_GNSS_INTEGRITY: (telemetry.gnss_integrity, 1.0),
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: (telemetry.gps_global_origin, 0.0),
}
_STREAMS: Mapping[Kind, Mapping[int, tuple[_Builder, float]]] = {"ardupilot": _ARDUPILOT, "px4": _PX4}
_TRUTH_RATE_HZ = 10.0  # chosen: as often as the fleet's reports
_TRUTH_MESSAGES = (mavlink.MAVLINK_MSG_ID_SIMSTATE, mavlink.MAVLINK_MSG_ID_SIM_STATE)


_RATE_PARAMETERS: Mapping[int, str] = {
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: "MAV1_EXT_STAT",
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: "MAV1_EXT_STAT",
    mavlink.MAVLINK_MSG_ID_GPS2_RAW: "MAV1_EXT_STAT",
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: "MAV1_POSITION",
    mavlink.MAVLINK_MSG_ID_ATTITUDE: "MAV1_EXTRA1",
    mavlink.MAVLINK_MSG_ID_VFR_HUD: "MAV1_EXTRA2",
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: "MAV1_EXTRA3",
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: "MAV1_EXTRA3",
}
"""ArduPilot's stream that a message belongs to; here its rate bounds the message's own one. Read at boot, as from 4.7 on."""


class Streams:
    """Which message is due when.

    Phases differ by message, so that a vehicle does not send everything at once.
    """

    def __init__(
        self, kind: Kind, params: Mapping[str, float], rng: np.random.Generator, starts_at_s: float, truth_messages: bool
    ) -> None:
        self._streams = _STREAMS[kind]
        self._interval_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self._defaults_hz = {
            message_id: min(rate, params.get(_RATE_PARAMETERS.get(message_id, ""), rate))
            for message_id, (_, rate) in self._streams.items()
        }
        if truth_messages:
            self._defaults_hz.update(dict.fromkeys(_TRUTH_MESSAGES, _TRUTH_RATE_HZ))
        for message_id, rate_hz in self._defaults_hz.items():
            phase = float(rng.random())
            if rate_hz > 0.0:
                self._interval_s[message_id] = 1.0 / rate_hz
                self._due_s[message_id] = starts_at_s + phase / rate_hz

    def set_interval(self, message_id: int, interval_us: float, at_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: -1 off, 0 the default rate, else microseconds.

        False where the message is not offered.
        """
        if message_id not in self._streams or not math.isfinite(interval_us):
            return False
        default_hz = self._defaults_hz[message_id]
        interval_s = interval_us * 1e-6 if interval_us > 0.0 else 1.0 / default_hz if interval_us == 0.0 and default_hz else 0.0
        if interval_s > 0.0:
            self._interval_s[message_id] = interval_s
            self._due_s[message_id] = at_s + interval_s
        else:
            self._interval_s.pop(message_id, None)
            self._due_s.pop(message_id, None)
        return True

    def due(self, at_s: float, take_snapshot: Callable[[float], Snapshot]) -> list[Any]:
        """Build what is due at a time (s); each message at most once, however small its interval."""
        if min(self._due_s.values(), default=math.inf) > at_s + EPSILON_S:
            return []
        snapshot, out = take_snapshot(at_s), []
        for message_id, due_s in self._due_s.items():
            if due_s <= at_s + EPSILON_S:
                interval = self._interval_s[message_id]
                self._due_s[message_id] = max(due_s + interval, at_s)
                message = self._streams[message_id][0](snapshot)
                if message is not None:
                    out.append(message)
        return out

    def build(self, message_id: int, snapshot: Snapshot) -> Any | None:
        """Build one message now (MAV_CMD_REQUEST_MESSAGE), or None where it is not offered."""
        return self._streams[message_id][0](snapshot) if message_id in self._streams else None
