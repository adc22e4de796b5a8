"""Our dialect: the messages of ardupilotmega and our own in one map beside pymavlink's."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from gcs_coloc.mavlink._generated import gcs_coloc

MESSAGE_CLASSES: Mapping[int, Any] = MappingProxyType({**ardupilotmega.mavlink_map, **gcs_coloc.mavlink_map})
"""pymavlink's message class (with `unpacker`, `crc_extra`, `ordered_fieldnames`) of each message id."""

CRC_EXTRA: Mapping[int, int] = MappingProxyType({number: cls.crc_extra for number, cls in MESSAGE_CLASSES.items()})
"""The last byte of each message's checksum (MAVLink's CRC_EXTRA): ends with different definitions refuse each other."""

GCS_SYSID = 255
GCS_COMPID = ardupilotmega.MAV_COMP_ID_MISSIONPLANNER
"""The ids of a ground station by custom."""

OWN_SYSID = 254
OWN_COMPID = ardupilotmega.MAV_COMP_ID_ONBOARD_COMPUTER
"""Our ids unless set otherwise: no vehicle and no ground station uses them by custom."""
