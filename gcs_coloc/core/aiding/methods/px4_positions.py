"""The position messages that PX4 fuses as they arrive.

They are GLOBAL_POSITION_SENSOR, and VISION_POSITION_ESTIMATE for PX4 1.14 to 1.17.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import acos, cos, exp, log, radians, sin, sqrt

import numpy as np

from gcs_coloc.core.aiding.methods.method import MethodContext, Moment
from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.inbound import CommandResult, GlobalOrigin
from gcs_coloc.core.messages.outbound import GlobalPositionSensor, Notice, VisionPosition

_EARTH_RADIUS_M = 6_371_000.0  # PX4's CONSTANTS_RADIUS_OF_EARTH
_LEAD_S = 1.0  # chosen: ranges come several times in it, and the variance grows well beyond its rounding
_MOST_CORRELATION_S = 20.0  # chosen: what is the same for longer is a bias, which no filter takes for noise


class CorrelatedPositions:
    """The factor by which the 1-sigma of our positions is widened, as their errors are correlated.

    The errors last for seconds, and a filter that takes the positions for independent ones becomes too sure. EKF2 took ten a
    second, was 3.5 to 7 times too sure, and then refused them.

    Where an estimate keeps its covariance P while a prediction by t would have P(t) > P, new ranges make up the difference: a
    share rho = P / P(t) of the error is left. Of n positions with that correlation from one to the next, n (1 - rho) / (1 + rho)
    are independent ones.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._factor = 1.0
        self._due_s = float("-inf")

    def factor(self, moment: Moment, where: Estimate) -> float:
        """Return by what the 1-sigma is to be multiplied, 1 at least."""
        # Without ranges nothing is forgotten; what counted before does so still.
        if moment.now_s >= self._due_s and where.ranges_in_use > 0:
            self._due_s = moment.now_s + _LEAD_S
            ahead = moment.locate_node(where.vehicle, where.at_s + _LEAD_S)
            if isinstance(ahead, Estimate):
                growth = _horizontal_m2(ahead) / _horizontal_m2(where)
                least = exp(_LEAD_S / _MOST_CORRELATION_S)
                rho = exp(-log(max(growth, least)) * self._period_s / _LEAD_S)
                self._factor = sqrt((1.0 + rho) / (1.0 - rho))
        return self._factor


def _horizontal_m2(estimate: Estimate) -> float:
    return float(np.trace(estimate.covariance[:2, :2]))


class _FusedPosition(ABC):
    """A method whose position message PX4 stamps when it arrives.

    The message cannot say that there is no fix, so nothing is sent then.
    """

    age_s = 0.0

    def __init__(self, context: MethodContext) -> None:
        self._sysid = context.sysid
        self._correlated = CorrelatedPositions(1.0 / context.settings.rate_hz)

    @abstractmethod
    def _message(
        self, time_usec: int, geodetic: tuple[float, float, float], sigma_h_m: float, sigma_v_m: float
    ) -> GlobalPositionSensor | VisionPosition:
        """Return the message of a place (latitude, longitude, height above mean sea level) and its 1-sigmas."""

    def _is_ready(self) -> bool:
        """Return whether the vehicle's place can be told in the message."""
        return True

    def build_messages(self, moment: Moment) -> Sequence[GlobalPositionSensor | VisionPosition]:
        """As the protocol says."""
        where, frame = moment.where, moment.frame
        if moment.inhibit is not None or isinstance(where, NoEstimate) or frame is None or not self._is_ready():
            return []
        geodetic = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        sigma_h_m = horizontal_sigma_m(where.covariance) * self._correlated.factor(moment, where)
        return [self._message(moment.unix_us(moment.now_s), geodetic, sigma_h_m, sqrt(float(where.covariance[2, 2])))]

    def build_last_messages(self) -> Sequence[GlobalPositionSensor | VisionPosition]:
        """As the protocol says: the message cannot say that there is no position."""
        return []

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says: no command is sent."""
        del result
        return []

    def without_fix(self) -> str:
        """As the protocol says."""
        return "nothing"


class GlobalPositionSensorMethod(_FusedPosition):
    """GLOBAL_POSITION_SENSOR (296)."""

    def _message(
        self, time_usec: int, geodetic: tuple[float, float, float], sigma_h_m: float, sigma_v_m: float
    ) -> GlobalPositionSensor:
        return GlobalPositionSensor(self._sysid, time_usec, *geodetic, sigma_h_m, sigma_v_m)

    def with_fix(self) -> str:
        """As the protocol says."""
        return "GLOBAL_POSITION_SENSOR"


class VisionPositionMethod(_FusedPosition):
    """VISION_POSITION_ESTIMATE (102), from the origin of the vehicle's own local frame.

    It carries no orientation (NaN): a yaw that EKF2 took for measured would turn the vehicle.
    """

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._origins = context.origins

    def _is_ready(self) -> bool:
        return self._sysid in self._origins

    def _message(
        self, time_usec: int, geodetic: tuple[float, float, float], sigma_h_m: float, sigma_v_m: float
    ) -> VisionPosition:
        origin = self._origins[self._sysid]
        lat_deg, lon_deg, alt_msl_m = geodetic
        north_m, east_m = px4_local_m(origin, lat_deg, lon_deg)
        variance_m2 = (sigma_h_m**2, sigma_h_m**2, sigma_v_m**2)
        return VisionPosition(self._sysid, time_usec, north_m, east_m, origin.alt_msl_m - alt_msl_m, variance_m2)

    def with_fix(self) -> str:
        """As the protocol says."""
        return "VISION_POSITION_ESTIMATE" if self._is_ready() else "nothing: it has not reported the origin of its local frame"


def px4_local_m(origin: GlobalOrigin, lat_deg: float, lon_deg: float) -> tuple[float, float]:
    """Return how far north and east of an origin a place lies, m, in PX4's own projection.

    The projection is azimuthal equidistant on a sphere (lib/geo, MapProjection). On the ellipsoid a kilometre is up to 3 m
    longer or shorter.
    """
    lat, lat_0, dlon = radians(lat_deg), radians(origin.lat_deg), radians(lon_deg - origin.lon_deg)
    arc = acos(min(max(sin(lat_0) * sin(lat) + cos(lat_0) * cos(lat) * cos(dlon), -1.0), 1.0))
    scale_m = _EARTH_RADIUS_M * (arc / sin(arc) if arc > 0.0 else 1.0)
    return scale_m * (cos(lat_0) * sin(lat) - sin(lat_0) * cos(lat) * cos(dlon)), scale_m * cos(lat) * sin(dlon)
