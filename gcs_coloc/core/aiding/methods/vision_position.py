"""VISION_POSITION_ESTIMATE: the position for PX4 1.14 to 1.17, from the origin of the vehicle's own local frame."""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, cos, radians, sin

from gcs_coloc.core.aiding.methods.global_position_sensor import CorrelatedPositions
from gcs_coloc.core.aiding.methods.method import MethodContext, Moment
from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import NoEstimate
from gcs_coloc.core.messages.inbound import CommandResult, GlobalOrigin
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, VisionPosition

_EARTH_RADIUS_M = 6_371_000.0  # PX4's CONSTANTS_RADIUS_OF_EARTH


class VisionPositionMethod:
    """VISION_POSITION_ESTIMATE, which PX4 stamps when it arrives; it cannot say that there is no fix, so then nothing is sent.

    It carries no orientation (NaN): a yaw that EKF2 took for measured would turn the vehicle.
    """

    age_s = 0.0

    def __init__(self, context: MethodContext) -> None:
        self._sysid = context.sysid
        self._origins = context.origins
        self._correlated = CorrelatedPositions(1.0 / context.settings.rate_hz)

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        where, frame, origin = moment.where, moment.frame, self._origins.get(self._sysid)
        if moment.inhibit is not None or isinstance(where, NoEstimate) or frame is None or origin is None:
            return []
        lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        north_m, east_m = px4_local_m(origin, lat_deg, lon_deg)
        variance_m2 = (horizontal_sigma_m(where.covariance) * self._correlated.factor(moment, where)) ** 2
        down_m, down_m2 = origin.alt_msl_m - alt_msl_m, float(where.covariance[2, 2])
        time_usec = moment.unix_us(moment.now_s)
        return [VisionPosition(self._sysid, time_usec, north_m, east_m, down_m, (variance_m2, variance_m2, down_m2))]

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """As the protocol says: the message cannot say that there is no position."""
        return []

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says: no command is sent."""
        del result
        return []

    def with_fix(self) -> str:
        """As the protocol says."""
        known = self._sysid in self._origins
        return "VISION_POSITION_ESTIMATE" if known else "nothing: it has not reported the origin of its local frame"

    def without_fix(self) -> str:
        """As the protocol says."""
        return "nothing"


def px4_local_m(origin: GlobalOrigin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Return north and east of the origin, m, in PX4's projection: azimuthal equidistant on a sphere (lib/geo MapProjection).

    On the ellipsoid a kilometre is up to 3 m longer or shorter.
    """
    lat, lat_0, dlon = radians(lat_deg), radians(origin.lat_deg), radians(lon_deg - origin.lon_deg)
    arc = acos(min(max(sin(lat_0) * sin(lat) + cos(lat_0) * cos(lat) * cos(dlon), -1.0), 1.0))
    scale_m = _EARTH_RADIUS_M * (arc / sin(arc) if arc > 0.0 else 1.0)
    return scale_m * (cos(lat_0) * sin(lat) - sin(lat_0) * cos(lat) * cos(dlon)), scale_m * cos(lat) * sin(dlon)
