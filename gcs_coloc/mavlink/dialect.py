"""The messages this package knows: ardupilotmega and, beside it, our own, in one map that pymavlink itself does not see."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from gcs_coloc.mavlink._generated import gcs_coloc

MESSAGE_CLASSES: Mapping[int, Any] = MappingProxyType({**ardupilotmega.mavlink_map, **gcs_coloc.mavlink_map})
"""pymavlink's message class (with `unpacker`, `crc_extra`, `ordered_fieldnames`) of each message id."""

CRC_EXTRA: Mapping[int, int] = MappingProxyType({number: cls.crc_extra for number, cls in MESSAGE_CLASSES.items()})
"""The byte that closes each message's checksum, so that two ends with different definitions do not understand each other."""

GCS_SYSID = 255
GCS_COMPID = ardupilotmega.MAV_COMP_ID_MISSIONPLANNER
"""Who a ground station is on the wire by custom."""

OWN_SYSID = 254
OWN_COMPID = ardupilotmega.MAV_COMP_ID_ONBOARD_COMPUTER
"""Who we are on the wire unless set otherwise: ids that are no vehicle's and no ground station's by custom."""
