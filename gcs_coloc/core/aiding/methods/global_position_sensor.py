"""GLOBAL_POSITION_SENSOR: the position for PX4. The message cannot say that there is no fix: the method then falls silent."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from gcs_coloc.core.aiding.methods.method import MethodContext, Moment
from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import NoEstimate
from gcs_coloc.core.messages.inbound import CommandResult
from gcs_coloc.core.messages.outbound import AidingMessage, GlobalPositionSensor, Notice


class GlobalPositionSensorMethod:
    """GLOBAL_POSITION_SENSOR, which PX4 stamps when it arrives."""

    age_s = 0.0

    def __init__(self, context: MethodContext) -> None:
        self._sysid = context.sysid

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        where, frame = moment.where, moment.frame
        if moment.inhibit is not None or isinstance(where, NoEstimate) or frame is None:
            return []
        lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        eph_m, epv_m = horizontal_sigma_m(where.covariance), sqrt(float(where.covariance[2, 2]))
        return [GlobalPositionSensor(self._sysid, moment.unix_us(moment.now_s), lat_deg, lon_deg, alt_msl_m, eph_m, epv_m)]

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """As the protocol says: the message cannot say that there is no position."""
        return []

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says: no command is sent."""
        del result
        return []

    def with_fix(self) -> str:
        """As the protocol says."""
        return "GLOBAL_POSITION_SENSOR"

    def without_fix(self) -> str:
        """As the protocol says."""
        return "nothing"
