"""The position messages that PX4 fuses as they arrive: which of them it takes, and from which origin."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import acos, cos, exp, log, radians, sin, sqrt

import numpy as np

from gcs_coloc.core.aiding.methods.method import AidingMethod, MethodContext, Moment
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingMethodName
from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.inbound import GlobalOrigin
from gcs_coloc.core.messages.outbound import GlobalPositionSensor, OriginRequest, VisionPosition

SENSOR_ID = 1
"""The id of our GLOBAL_POSITION_SENSOR, by which EKF2_AGPn_ID selects it."""
AGP_SLOTS = range(4)  # PX4's MAX_AGP_INSTANCES
AGP_CONTROL, AGP_ID, EV_CONTROL = "EKF2_AGP{}_CTRL", "EKF2_AGP{}_ID", "EKF2_EV_CTRL"
_ORIGIN_RETRY_S, _ORIGIN_FRESH_S = 2.0, 30.0  # chosen: PX4 reports a new one by itself; 9 + 8 bytes cost a radio nothing
HORIZONTAL = 1
"""Bit of either control: the horizontal position is fused."""
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
            ahead = moment.known.locate_node(where.vehicle, where.at_s + _LEAD_S)
            if isinstance(ahead, Estimate):
                growth = _horizontal_m2(ahead) / _horizontal_m2(where)
                least = exp(_LEAD_S / _MOST_CORRELATION_S)
                rho = exp(-log(max(growth, least)) * self._period_s / _LEAD_S)
                self._factor = sqrt((1.0 + rho) / (1.0 - rho))
        return self._factor


def _horizontal_m2(estimate: Estimate) -> float:
    return float(np.trace(estimate.covariance[:2, :2]))


class _FusedPosition(AidingMethod):
    """A position message that PX4 stamps when it arrives; it cannot say that there is no fix."""

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
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
        """As the base says."""
        where, frame = moment.where, moment.frame
        if moment.inhibit is not None or isinstance(where, NoEstimate) or frame is None or not self._is_ready():
            return []
        geodetic = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        sigma_h_m = horizontal_sigma_m(where.covariance) * self._correlated.factor(moment, where)
        return [self._message(moment.unix_us(moment.now_s), geodetic, sigma_h_m, sqrt(float(where.covariance[2, 2])))]


class GlobalPositionSensorMethod(_FusedPosition):
    """GLOBAL_POSITION_SENSOR (296)."""

    def _message(
        self, time_usec: int, geodetic: tuple[float, float, float], sigma_h_m: float, sigma_v_m: float
    ) -> GlobalPositionSensor:
        return GlobalPositionSensor(self._sysid, time_usec, *geodetic, sigma_h_m, sigma_v_m)

    def with_fix(self) -> str:
        """As the base says."""
        return "GLOBAL_POSITION_SENSOR"


class VisionPositionMethod(_FusedPosition):
    """VISION_POSITION_ESTIMATE (102) from the vehicle's own origin; an orientation would turn the vehicle."""

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._origin = context.origin

    def _is_ready(self) -> bool:
        return self._origin() is not None

    def _message(
        self, time_usec: int, geodetic: tuple[float, float, float], sigma_h_m: float, sigma_v_m: float
    ) -> VisionPosition:
        origin = self._origin()
        assert origin is not None
        lat_deg, lon_deg, alt_msl_m = geodetic
        north_m, east_m = px4_local_m(origin, lat_deg, lon_deg)
        variance_m2 = (sigma_h_m**2, sigma_h_m**2, sigma_v_m**2)
        return VisionPosition(self._sysid, time_usec, north_m, east_m, origin.alt_msl_m - alt_msl_m, variance_m2)

    def with_fix(self) -> str:
        """As the base says."""
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


def px4_method(value: Callable[[str], float | None]) -> AidingMethodName:
    """Return the aiding method that a PX4 takes, by its parameters; "auto" where it takes none.

    `value` returns a parameter by its name, None where the vehicle does not have it.

    GLOBAL_POSITION_SENSOR is received since EKF2_AGP0_CTRL exists (2026). EKF2_AGP_CTRL of 1.15 to 1.17 is not that way in.
    """
    for slot in AGP_SLOTS:
        control = value(AGP_CONTROL.format(slot))
        if control is not None and int(control) & HORIZONTAL and value(AGP_ID.format(slot)) == SENSOR_ID:
            return "global_position_sensor"
    vision = value(EV_CONTROL)
    return "vision_position" if vision is not None and int(vision) & HORIZONTAL else "auto"


class Px4Methods:
    """The method of each PX4 of one fleet, by its parameters."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters

    def request(self, sysid: int, now_s: float) -> None:
        """Request the parameters that decide on a vehicle's method, until they show one."""
        if self.method(sysid) == "auto" or not self._answered(sysid):
            for name in self._names(sysid):
                self._parameters.request(sysid, name, now_s)

    def method(self, sysid: int) -> AidingMethodName:
        """Return the method of a vehicle; "auto" where it takes none, or has not shown yet which.

        Of a vehicle that answers nothing it is not known: what it may take does no harm.
        """
        method = px4_method(lambda name: self._parameters.value(sysid, name))
        if method != "global_position_sensor" and not self.is_settled(sysid):
            return "auto"
        return method if self._answered(sysid) else "global_position_sensor"

    def is_settled(self, sysid: int) -> bool:
        """Return whether the parameters that decide on a vehicle's method are known or asked for in vain."""
        return all(self._parameters.is_settled(sysid, name) for name in self._names(sysid))

    def _answered(self, sysid: int) -> bool:
        return any(self._parameters.value(sysid, name) is not None for name in self._names(sysid))

    def _names(self, sysid: int) -> list[str]:
        # A slot exists where the first one does; most vehicles use that.
        slots = AGP_SLOTS if self._parameters.value(sysid, AGP_CONTROL.format(0)) is not None else AGP_SLOTS[:1]
        return [*(name.format(slot) for slot in slots for name in (AGP_CONTROL, AGP_ID)), EV_CONTROL]


@dataclass(slots=True)
class LocalOrigin:
    """The origin of one PX4's local frame, as it has reported it, and when it is requested next."""

    reported: GlobalOrigin | None = None
    _due_s: float = float("-inf")

    def request(self, sysid: int, now_s: float) -> list[OriginRequest]:
        """Return the request for it, if one is due."""
        if now_s < self._due_s:
            return []
        self._due_s = now_s + (_ORIGIN_FRESH_S if self.reported is not None else _ORIGIN_RETRY_S)
        return [OriginRequest(sysid)]
