"""GPS_INPUT: an estimate turned into a fix of a synthetic receiver, honest or not at all.

Position and velocity are those of the delay ago that the vehicle's EKF applies: its parameter, or `lag_s` where that is 0.
HDOP is what its definition says, the position's horizontal 1-sigma in units of the 1-sigma of one range (the peer's own error
included), for the filtered position: the geometry of the moment alone would call a position bad that the filter knows well.

Where the position may not be stated as a fix (`fix_policy`), the message goes out all the same, at the same rate, with
fix_type 1: the autopilot then knows that the receiver lives and has no fix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

from gcs_coloc.core.aiding.fix_policy import CHECK, SCALE, EkfGates
from gcs_coloc.core.aiding.methods.external_position import ExternalPositionMethod
from gcs_coloc.core.aiding.methods.method import AidingMethod, MethodContext, Moment
from gcs_coloc.core.clocks.utc import gps_week_and_ms
from gcs_coloc.core.error_ellipse import horizontal_sigma_m, worst_sigma
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.inbound import FIX_3D, CommandResult
from gcs_coloc.core.messages.outbound import AidingMessage, GpsInput, Notice

DELAY_MS = (("GPS1_DELAY_MS", "GPS_DELAY_MS"), ("GPS2_DELAY_MS", "GPS_DELAY_MS2"))
"""ArduPilot's delay of each receiver instance; the newest name first: ArduPilot 4.6 renamed them."""
_MOST_DELAY_MS = 250.0  # EKF3 takes no longer one (AP_NavEKF3, setup_core)
_NO_FIX = 1  # GPS_FIX_TYPE_NO_FIX
_SATELLITES_WITH_FIX = 7  # enough for EKF3 (6), never so many that a switch by count would prefer us to a real receiver
_UNKNOWN_ACCURACY_M = 9999.0  # chosen: says that nothing is known, and is finite
_UNKNOWN_DOP = 99.99
_NOMINAL_RANGE_SIGMA_M = 2.0  # by which EKF3's limits are one: 5 m of horizontal accuracy, HDOP 2.5 (EK3_CHECK_SCALE=100)


class GpsInputMethod(AidingMethod):
    """GPS_INPUT, the position of as long ago as the vehicle takes it to be."""

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._lag_s = context.settings.lag_s
        self._gps_id = context.settings.gps_id
        self._parameters = context.parameters

    @property
    def age_s(self) -> float:
        """The age that the vehicle takes GPS_INPUT to have, s: GPS2_DELAY_MS where above 0, else `lag_s`."""
        delays_ms = (self._parameters.value(self._sysid, name) for name in DELAY_MS[self._gps_id])
        return next((min(ms, _MOST_DELAY_MS) / 1e3 for ms in delays_ms if ms is not None and ms > 0.0), self._lag_s)

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the base says: one GPS_INPUT, with a fix or without."""
        for name in DELAY_MS[self._gps_id]:
            self._parameters.request(self._sysid, name, moment.now_s)
            if self._parameters.value(self._sysid, name) is not None:
                break
        at_s, utc = moment.arrives_s - self.age_s, moment.utc_minus_service_s
        unix_s = at_s + utc if utc is not None else None
        where = moment.where if moment.inhibit is None and isinstance(moment.where, Estimate) else None
        return [gps_input(self._sysid, where, moment.frame, moment.known.range_sigma_m, unix_s, self._gps_id)]

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """As the base says: no fix."""
        return [no_fix(self._sysid, self._gps_id)]

    def with_fix(self) -> str:
        """As the base says."""
        return "3D fix"

    def without_fix(self) -> str:
        """As the base says."""
        return "no fix"


def gps_input(
    sysid: int, answer: Estimate | None, frame: LocalFrame | None, range_sigma_m: float | None, unix_s: float | None, gps_id: int
) -> GpsInput:
    """GPS_INPUT for one vehicle from the estimator's answer, None where that may not be stated as a fix.

    `range_sigma_m` is the 1-sigma of one range with the error of the peer's position in it, None where no range was had of
    late (standby); `unix_s` is the UTC time of the answer, None where unknown.
    """
    week, week_ms = gps_week_and_ms(unix_s) if unix_s is not None else (0, 0)
    without = no_fix(sysid, gps_id, round(unix_s * 1e6) if unix_s is not None else 0, week, week_ms)
    if frame is None or answer is None:
        return without
    ve, vn, vu = answer.velocity_enu_mps.tolist()
    lat_deg, lon_deg, alt_msl_m = frame.geodetic_from_enu(*answer.position_enu_m.tolist())
    vn_mps, ve_mps, vd_mps = frame.ned_from_enu_velocity(lat_deg, lon_deg, (ve, vn, vu))
    p = answer.covariance
    vert_accuracy_m = sqrt(float(p[2, 2]))
    return replace(
        without,
        fix_type=FIX_3D,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=alt_msl_m,
        hdop=_dop(sqrt(float(p[0, 0] + p[1, 1])), range_sigma_m),
        vdop=_dop(vert_accuracy_m, range_sigma_m),
        vn_mps=vn_mps,
        ve_mps=ve_mps,
        vd_mps=vd_mps,
        speed_accuracy_mps=worst_sigma(p[3:6, 3:6]),
        horiz_accuracy_m=horizontal_sigma_m(p),
        vert_accuracy_m=vert_accuracy_m,
        satellites=_SATELLITES_WITH_FIX,
    )


def _dop(sigma_m: float, range_sigma_m: float | None) -> float:
    return min(sigma_m / (range_sigma_m if range_sigma_m is not None else _NOMINAL_RANGE_SIGMA_M), _UNKNOWN_DOP)


def no_fix(sysid: int, gps_id: int, time_usec: int = 0, gps_week: int = 0, gps_time_of_week_ms: int = 0) -> GpsInput:
    """GPS_INPUT that says: this receiver is alive and has no fix."""
    return GpsInput(
        sysid=sysid,
        gps_id=gps_id,
        time_usec=time_usec,
        gps_week=gps_week,
        gps_time_of_week_ms=gps_time_of_week_ms,
        fix_type=_NO_FIX,
        lat_deg=0.0,
        lon_deg=0.0,
        alt_msl_m=0.0,
        hdop=_UNKNOWN_DOP,
        vdop=_UNKNOWN_DOP,
        vn_mps=0.0,
        ve_mps=0.0,
        vd_mps=0.0,
        speed_accuracy_mps=_UNKNOWN_ACCURACY_M,
        horiz_accuracy_m=_UNKNOWN_ACCURACY_M,
        vert_accuracy_m=_UNKNOWN_ACCURACY_M,
        satellites=0,
    )


_COARSE_FOR_S = 1.0  # chosen: a coarse moment changes nothing
_FINE_FOR_S = 5.0  # chosen: longer than for coarse, so that the methods do not alternate


class GpsInputOrExternalMethod(AidingMethod):
    """GPS_INPUT, with external position estimates beside it where the fix is too coarse.

    The estimates are sent while the vehicle's EKF has no absolute position and would not align on GPS_INPUT.

    EKF3's limits hold for (re)alignment alone: once it has an absolute position it fuses a GPS of any stated accuracy, and
    refuses every estimate. A vehicle that accepts the estimates does not use our GPS_INPUT. That goes on with fix_type 1, so
    that the two are never used in turns.
    """

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._gps = GpsInputMethod(context)
        self._external = ExternalPositionMethod(context)
        self._settings = context.settings
        self._parameters = context.parameters
        self._coarse: str | None = None
        self._changing_since_s: float | None = None
        self._by_external = False

    @property
    def age_s(self) -> float:
        """As the base says."""
        return self._gps.age_s

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the base says."""
        for name in (CHECK, SCALE):
            self._parameters.request(self._sysid, name, moment.now_s)
        (message,) = self._gps.build_messages(moment)
        assert isinstance(message, GpsInput)
        if moment.inhibit is not None or moment.standby:
            self._by_external = False
            return [message]
        if moment.known.is_aligned and not self._external.is_accepted(moment.now_s):
            was_coarse, self._coarse, self._changing_since_s, self._by_external = self._coarse, None, None, False
            text = "its EKF has an absolute position again: GPS_INPUT alone"
            return [message, Notice(moment.now_s, self._sysid, "info", text)] if was_coarse is not None else [message]
        out = self._update_coarse(message, moment.now_s)
        self._by_external = False
        if self._coarse is not None:
            out.extend(self._external.build_messages(moment))
            self._by_external = self._external.is_accepted(moment.now_s)
        stood_back = no_fix(self._sysid, message.gps_id, message.time_usec, message.gps_week, message.gps_time_of_week_ms)
        return [stood_back if self._by_external else message, *out]

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """As the base says."""
        return self._gps.build_last_messages()

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the base says."""
        return self._external.add_result(result)

    def with_fix(self) -> str:
        """As the base says."""
        if self._coarse is None:
            return self._gps.with_fix()
        if self._by_external:
            return f"{self._external.with_fix()}, for it is too coarse for GPS_INPUT: {self._coarse}"
        return f"{self._gps.with_fix()}, on which its EKF may not align: {self._coarse}"

    def without_fix(self) -> str:
        """As the base says."""
        return self._gps.without_fix()

    def _update_coarse(self, message: GpsInput, now_s: float) -> list[AidingMessage | Notice]:
        """Update whether the fix is too coarse, for long enough, for the EKF; return the notice of a change."""
        refusal = self._gates().refusal(message)
        if (refusal is None) == (self._coarse is None):
            self._changing_since_s = None
            self._coarse = refusal
            return []
        if self._changing_since_s is None:
            self._changing_since_s = now_s
        if now_s - self._changing_since_s < (_COARSE_FOR_S if refusal is not None else _FINE_FOR_S):
            return []
        self._coarse, self._changing_since_s = refusal, None
        if refusal is None:
            return [Notice(now_s, self._sysid, "info", "good enough for its EKF again: GPS_INPUT alone")]
        text = f"too coarse for its EKF to align on by {CHECK} ({refusal}): external position estimates are sent as well"
        return [Notice(now_s, self._sysid, "warning", text)]

    def _gates(self) -> EkfGates:
        checks, scale = (self._parameters.value(self._sysid, name) for name in (CHECK, SCALE))
        return EkfGates(
            int(checks) if checks is not None else self._settings.ek3_gps_check,
            scale if scale is not None else self._settings.ek3_check_scale,
        )
