"""Encoder of the core's outputs and of our own heartbeat: messages to bytes.

Commands and parameters are addressed to the vehicle's autopilot.
"""

from __future__ import annotations

import math
import struct
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.aiding.methods.px4_positions import SENSOR_ID
from gcs_coloc.core.messages.outbound import (
    ExternalPosition,
    GlobalPositionSensor,
    GpsInput,
    OriginRequest,
    ParameterRequest,
    RangingBeacon,
    SensorEnable,
    Stream,
    StreamRequest,
    TimeSyncRequest,
    ToVehicle,
    VisionPosition,
)
from gcs_coloc.mavlink._generated.gcs_coloc import RANGING_BEACON_ALT_TYPE_MSL, MAVLink_ranging_beacon_message
from gcs_coloc.mavlink.answers import ESTIMATOR_SENSOR_ENABLE
from gcs_coloc.mavlink.framing import MESSAGE_CLASSES, OWN_COMPID, OWN_SYSID
from gcs_coloc.mavlink.signing import Stamp

MAX_DESTINATIONS = 1024
"""Destinations that are numbered apart. Chosen: more than a fleet has; the oldest makes room and begins at 0 again."""
_FUSION_SOURCE_GPS = 0
"""ESTIMATOR_SENSOR_FUSION_SOURCE_GPS of development.xml."""
_BY_NAME = -1
"""PARAM_REQUEST_READ's param_index where the parameter is named (MAVLink common.xml)."""
_STATUSTEXT_BYTES = 50
"""The length of STATUSTEXT's text (MAVLink common.xml)."""
_MAX_CHUNKS = 256
"""STATUSTEXT's chunk_seq has eight bits."""

_ID_OF_NAME = {cls.msgname: number for number, cls in MESSAGE_CLASSES.items()}

STREAM_IDS = {stream: _ID_OF_NAME[stream.value] for stream in Stream}
"""MAVLink message id of each stream that vehicles are asked for."""


class Encoder:
    """Encodes outputs as MAVLink 2 frames, signed where a stamp is given.

    The frames of each destination are numbered on their own.
    """

    def __init__(self, *, sysid: int = OWN_SYSID, compid: int = OWN_COMPID) -> None:
        self._mavlink = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._next_sequence: OrderedDict[Hashable, int] = OrderedDict()
        self._text_id = 0

    def encode(self, message: ToVehicle, destination: Hashable, stamp: Stamp | None = None) -> bytes:
        """Encode an output for the address `destination`.

        Raises ValueError where a number in it is not finite or does not fit its field.
        """
        return self._pack(_wire_message(message), destination, stamp)

    def heartbeat(self, destination: Hashable, stamp: Stamp | None = None) -> bytes:
        """Encode our own HEARTBEAT: an onboard controller, no autopilot."""
        message = mavlink.MAVLink_heartbeat_message(
            type=mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot=mavlink.MAV_AUTOPILOT_INVALID,
            base_mode=0,
            custom_mode=0,
            system_status=mavlink.MAV_STATE_ACTIVE,
            mavlink_version=3,
        )
        return self._pack(message, destination, stamp)

    def status_text(
        self, severity: int, text: str, destination: Hashable, next_stamp: Callable[[], Stamp] | None = None
    ) -> list[bytes]:
        """Encode a text as one STATUSTEXT (253) or, where it is long, as several.

        The frames of a long text belong together by its id. Each has a stamp of its own.
        """
        data = text.encode("ascii", "replace")
        chunks, text_id = [data], 0
        if len(data) > _STATUSTEXT_BYTES:
            self._text_id = text_id = self._text_id % 0xFFFF + 1
            # The last one has room for the zero that ends it.
            chunks = [data[start : start + _STATUSTEXT_BYTES] for start in range(0, len(data) + 1, _STATUSTEXT_BYTES)]
        messages = (
            mavlink.MAVLink_statustext_message(severity, chunk, text_id, number)
            for number, chunk in enumerate(chunks[:_MAX_CHUNKS])
        )
        return [self._pack(message, destination, next_stamp() if next_stamp is not None else None) for message in messages]

    def _pack(self, message: Any, destination: Hashable, stamp: Stamp | None) -> bytes:
        sequence = self._next_sequence.pop(destination, 0)
        if len(self._next_sequence) >= MAX_DESTINATIONS:
            self._next_sequence.popitem(last=False)
        self._next_sequence[destination] = (sequence + 1) & 0xFF
        self._mavlink.seq = sequence
        signing = self._mavlink.signing
        signing.sign_outgoing = stamp is not None
        if stamp is not None:
            signing.secret_key, signing.link_id, signing.timestamp = stamp.key, stamp.link_id, stamp.timestamp
        try:
            packed = bytes(message.pack(self._mavlink))
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{message.msgname} cannot be encoded: {error}") from error
        return packed


def _wire_message(message: ToVehicle) -> Any:
    """The message of pymavlink's. ValueError where a number in it is not finite or impossible."""
    if isinstance(message, GpsInput):
        return _gps_input(message)
    if isinstance(message, TimeSyncRequest):
        return mavlink.MAVLink_timesync_message(tc1=0, ts1=message.ts1_ns)
    if isinstance(message, StreamRequest):
        interval = (STREAM_IDS[message.stream], message.interval_us)
        return _command(message.sysid, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, *interval)
    if isinstance(message, ExternalPosition):
        return _external_position(message)
    if isinstance(message, GlobalPositionSensor):
        return _global_position_sensor(message)
    if isinstance(message, VisionPosition):
        return _vision_position(message)
    if isinstance(message, RangingBeacon):
        return _ranging_beacon(message)
    target = (message.sysid, mavlink.MAV_COMP_ID_AUTOPILOT1)
    if isinstance(message, ParameterRequest):
        return mavlink.MAVLink_param_request_read_message(*target, message.name.encode(), _BY_NAME)
    if isinstance(message, OriginRequest):
        return _command(message.sysid, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
    if isinstance(message, SensorEnable):
        return _command(message.sysid, ESTIMATOR_SENSOR_ENABLE, _FUSION_SOURCE_GPS, 0, float(message.gps), math.nan)
    if not math.isfinite(message.value):
        raise ValueError("PARAM_SET cannot be encoded: the value is not finite")
    return mavlink.MAVLink_param_set_message(*target, message.name.encode(), message.value, message.kind)


def _gps_input(fix: GpsInput) -> Any:
    """GPS_INPUT (232), always with horizontal velocity and altitude.

    ArduPilot uses an ignored horizontal velocity or altitude as zero, so these are never ignored.
    The vertical velocity always is, also without a fix: fused (EK3_SRC1_VELZ=3), it moves EKF3's height, which comes back as
    the vehicle's, a loop that swung the true altitude by 2 to 4.5 m. ArduPilot's driver never goes back to ignoring it.
    """
    _require_position(fix, "GPS_INPUT")
    return mavlink.MAVLink_gps_input_message(
        time_usec=fix.time_usec,
        gps_id=fix.gps_id,
        ignore_flags=mavlink.GPS_INPUT_IGNORE_FLAG_VEL_VERT,
        time_week_ms=fix.gps_time_of_week_ms,
        time_week=fix.gps_week,
        fix_type=fix.fix_type,
        lat=round(fix.lat_deg * 1e7),
        lon=round(fix.lon_deg * 1e7),
        alt=fix.alt_msl_m,
        hdop=fix.hdop,
        vdop=fix.vdop,
        vn=fix.vn_mps,
        ve=fix.ve_mps,
        vd=fix.vd_mps,
        speed_accuracy=fix.speed_accuracy_mps,
        horiz_accuracy=fix.horiz_accuracy_m,
        vert_accuracy=fix.vert_accuracy_m,
        satellites_visible=fix.satellites,
        yaw=0,
    )


def _command(sysid: int, command: int, *parameters: float) -> Any:
    """COMMAND_LONG (76), to the vehicle's autopilot component; parameters that are not given are 0."""
    seven = (*parameters, *(0.0,) * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(sysid, mavlink.MAV_COMP_ID_AUTOPILOT1, command, 0, *seven)


def _external_position(position: ExternalPosition) -> Any:
    """COMMAND_INT (75) MAV_CMD_EXTERNAL_POSITION_ESTIMATE; ArduPilot refuses it with an altitude."""
    _require_position(position, "MAV_CMD_EXTERNAL_POSITION_ESTIMATE")
    return mavlink.MAVLink_command_int_message(
        target_system=position.sysid,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        frame=mavlink.MAV_FRAME_GLOBAL,
        command=mavlink.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,
        current=0,
        autocontinue=0,
        param1=position.sent_s,
        param2=0.0,
        param3=position.accuracy_m,
        param4=0.0,
        x=round(position.lat_deg * 1e7),
        y=round(position.lon_deg * 1e7),
        z=math.nan,
    )


def _global_position_sensor(position: GlobalPositionSensor) -> Any:
    """GLOBAL_POSITION_SENSOR (296); PX4 refuses it with an eph of 0."""
    _require_position(position, "GLOBAL_POSITION_SENSOR")
    if position.eph_m <= 0.0:
        raise ValueError("GLOBAL_POSITION_SENSOR cannot be encoded: eph_m must be above 0")
    return mavlink.MAVLink_global_position_sensor_message(
        target_system=position.sysid,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        id=SENSOR_ID,
        time_usec=position.time_usec,
        processing_time=0,
        source=mavlink.GLOBAL_POSITION_SRC_PSEUDOLITES,
        flags=0,
        lat=round(position.lat_deg * 1e7),
        lon=round(position.lon_deg * 1e7),
        alt_ellipsoid=math.nan,
        alt=position.alt_msl_m,
        eph=position.eph_m,
        epv=position.epv_m,
    )


def _vision_position(position: VisionPosition) -> Any:
    """VISION_POSITION_ESTIMATE (102).

    PX4 reads the diagonal of the covariance: north, east and down are elements 0, 6 and 11.
    """
    numbers = (position.north_m, position.east_m, position.down_m, *position.variance_m2)
    if not all(math.isfinite(number) for number in numbers) or min(position.variance_m2) <= 0.0:
        raise ValueError("VISION_POSITION_ESTIMATE cannot be encoded: a number is not finite, or a variance not above 0")
    covariance = [0.0] * 21
    covariance[0], covariance[6], covariance[11] = position.variance_m2
    nowhere = (math.nan, math.nan, math.nan)
    return mavlink.MAVLink_vision_position_estimate_message(position.time_usec, *numbers[:3], *nowhere, covariance)


def _ranging_beacon(beacon: RangingBeacon) -> Any:
    """RANGING_BEACON (513), lengths in mm.

    PX4 reads the altitude against its own reference, which is above mean sea level.
    """
    _require_position(beacon, "RANGING_BEACON")
    return MAVLink_ranging_beacon_message(
        time_usec=beacon.boot_us,
        target_system=beacon.sysid,
        target_component=mavlink.MAV_COMP_ID_AUTOPILOT1,
        beacon_id=beacon.beacon_id,
        range=round(beacon.range_m * 1e3),
        lat=round(beacon.lat_deg * 1e7),
        lon=round(beacon.lon_deg * 1e7),
        alt=beacon.alt_msl_m,
        alt_type=RANGING_BEACON_ALT_TYPE_MSL,
        hacc_est=round(beacon.sigma_h_m * 1e3),
        vacc_est=round(beacon.sigma_v_m * 1e3),
        carrier_freq=0,
        range_accuracy=max(round(beacon.accuracy_m * 1e3), 1),
        sequence=beacon.sequence,
        status=0,
    )


def _require_position(position: GpsInput | ExternalPosition | GlobalPositionSensor | RangingBeacon, name: str) -> None:
    """Raise ValueError where a field is not finite or the position does not exist."""
    for field in position.__dataclass_fields__:
        if not math.isfinite(getattr(position, field)):
            raise ValueError(f"{name} cannot be encoded: {field} is not finite")
    if abs(position.lat_deg) > 90.0 or abs(position.lon_deg) > 180.0:
        raise ValueError(f"{name} cannot be encoded: {position.lat_deg}, {position.lon_deg} is no latitude and longitude")
