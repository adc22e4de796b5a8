"""GLOBAL_POSITION_SENSOR: the position for PX4, its accuracy stated for errors that successive positions share."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log, sqrt

import numpy as np

from gcs_coloc.core.aiding.methods.method import MethodContext, Moment
from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.inbound import CommandResult
from gcs_coloc.core.messages.outbound import AidingMessage, GlobalPositionSensor, Notice

_LEAD_S = 1.0  # chosen: ranges come several times in it, and the variance grows well beyond its rounding
_MOST_CORRELATION_S = 20.0  # chosen: what is the same for longer is a bias, which no filter takes for noise


class CorrelatedPositions:
    """How much too sure a filter is that takes our positions, whose errors last for seconds, for independent ones.

    EKF2 took ten a second so, was 3.5 to 7 times too sure, and then refused them. Where an estimate keeps its covariance P while
    a prediction by t would have P(t) > P, new ranges make up the difference: of the error a share rho = P / P(t) is left. Of n
    positions with that correlation from one to the next, n (1 - rho) / (1 + rho) are independent ones.
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
            ahead = moment.locate(where.at_s + _LEAD_S)
            if isinstance(ahead, Estimate):
                growth = _horizontal_m2(ahead) / _horizontal_m2(where)
                least = exp(_LEAD_S / _MOST_CORRELATION_S)
                rho = exp(-log(max(growth, least)) * self._period_s / _LEAD_S)
                self._factor = sqrt((1.0 + rho) / (1.0 - rho))
        return self._factor


def _horizontal_m2(estimate: Estimate) -> float:
    return float(np.trace(estimate.covariance[:2, :2]))


class GlobalPositionSensorMethod:
    """GLOBAL_POSITION_SENSOR, which PX4 stamps when it arrives; it cannot say that there is no fix, so then nothing is sent."""

    age_s = 0.0

    def __init__(self, context: MethodContext) -> None:
        self._sysid = context.sysid
        self._correlated = CorrelatedPositions(1.0 / context.settings.rate_hz)

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        where, frame = moment.where, moment.frame
        if moment.inhibit is not None or isinstance(where, NoEstimate) or frame is None:
            return []
        lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        eph_m = horizontal_sigma_m(where.covariance) * self._correlated.factor(moment, where)
        epv_m = sqrt(float(where.covariance[2, 2]))
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
