"""GPS_INPUT with external position estimates beside it: the method for ArduPilot."""

from __future__ import annotations

from collections.abc import Sequence

from gcs_coloc.core.aiding.ekf_gates import CHECK, SCALE, EkfGates
from gcs_coloc.core.aiding.methods.external_position import ExternalPositionMethod
from gcs_coloc.core.aiding.methods.gps_input import GpsInputMethod, no_fix
from gcs_coloc.core.aiding.methods.method import MethodContext, Moment
from gcs_coloc.core.messages.inbound import CommandResult
from gcs_coloc.core.messages.outbound import AidingMessage, GpsInput, Notice

_COARSE_FOR_S = 1.0  # chosen: a coarse moment changes nothing
_FINE_FOR_S = 5.0  # chosen: longer than for coarse, so that the methods do not alternate


class GpsInputOrExternalMethod:
    """GPS_INPUT, and external estimates beside it while its accuracy is beyond what the vehicle's EKF accepts of a GPS.

    A vehicle that accepts the estimates does not use our GPS_INPUT: that goes on with fix_type 1, so that the two are never used
    in turns. A vehicle that refuses them uses a GPS: GPS_INPUT then goes on as it is.
    """

    def __init__(self, context: MethodContext) -> None:
        self._gps = GpsInputMethod(context)
        self._external = ExternalPositionMethod(context)
        self.age_s = self._gps.age_s
        self._sysid = context.sysid
        self._settings = context.settings
        self._parameters = context.parameters
        self._coarse: str | None = None
        self._changing_since_s: float | None = None
        self._by_external = False

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        for name in (CHECK, SCALE):
            self._parameters.request(self._sysid, name, moment.now_s)
        (message,) = self._gps.build_messages(moment)
        assert isinstance(message, GpsInput)
        if moment.inhibit is not None or moment.standby:
            self._by_external = False
            return [message]
        out = self._update_coarse(message, moment.now_s)
        self._by_external = False
        if self._coarse is not None:
            out.extend(self._external.build_messages(moment))
            self._by_external = self._external.is_accepted(moment.now_s)
        stood_back = no_fix(self._sysid, message.gps_id, message.time_usec, message.gps_week, message.gps_time_of_week_ms)
        return [stood_back if self._by_external else message, *out]

    def build_last_messages(self) -> Sequence[AidingMessage]:
        """As the protocol says."""
        return self._gps.build_last_messages()

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says."""
        return self._external.add_result(result)

    def with_fix(self) -> str:
        """As the protocol says."""
        if self._coarse is None:
            return self._gps.with_fix()
        if self._by_external:
            return f"{self._external.with_fix()}, for it is too coarse for GPS_INPUT: {self._coarse}"
        return f"{self._gps.with_fix()}, which its EKF may refuse: {self._coarse}"

    def without_fix(self) -> str:
        """As the protocol says."""
        return self._gps.without_fix()

    def _update_coarse(self, message: GpsInput, now_s: float) -> list[AidingMessage | Notice]:
        """Whether the fix is coarse for the vehicle's EKF; it must be, or not be, for a while before it counts."""
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
        text = f"too coarse for its EKF by {CHECK} ({refusal}): external position estimates are sent as well"
        return [Notice(now_s, self._sysid, "warning", text)]

    def _gates(self) -> EkfGates:
        checks, scale = (self._parameters.value(self._sysid, name) for name in (CHECK, SCALE))
        return EkfGates(
            int(checks) if checks is not None else self._settings.ek3_gps_check,
            scale if scale is not None else self._settings.ek3_check_scale,
        )
