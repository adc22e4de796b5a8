"""External position estimates: a command that ArduPilot takes while it dead-reckons, by itself or beside GPS_INPUT.

EKF3 refuses a GPS whose stated accuracy is coarse, and drifts on. It takes a coarse position by
MAV_CMD_EXTERNAL_POSITION_ESTIMATE, and only while it uses no GPS: so its answer tells whether it uses what GPS_INPUT brings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from gcs_coloc.core.aiding.ekf_gates import CHECK, SCALE, EkfGates
from gcs_coloc.core.aiding.gps_input import no_fix
from gcs_coloc.core.aiding.methods import GpsInputMethod, Moment
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.error_bound import horizontal_sigma_m
from gcs_coloc.core.measurements import NoEstimate
from gcs_coloc.core.messages.aiding import CommandResult, ExternalPosition
from gcs_coloc.core.messages.outbound import AidingMessage, GpsInput, Notice
from gcs_coloc.core.telemetry.vehicles import Vehicle

COMMAND = 43003
"""MAV_CMD_EXTERNAL_POSITION_ESTIMATE."""

_ACCEPTED, _UNSUPPORTED, _IN_PROGRESS = 0, 3, 5
_RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed"}  # MAV_RESULT
_UNANSWERED = 5
_LASTS_PERIODS = 3.5
_WRAPS_S = 32_768.0  # param1 is a 32-bit float: 2 ms apart here
_COARSE_FOR_S = 1.0
_FINE_FOR_S = 5.0


class ExternalPositionMethod:
    """MAV_CMD_EXTERNAL_POSITION_ESTIMATE at a low rate, its answers watched. `refused` counts refusals by reason."""

    age_s = 0.0

    def __init__(self, vehicle: Vehicle, settings: AidingSettings, refused: Counter[str]) -> None:
        self._sysid = vehicle.sysid
        self._clock_began_s = vehicle.first_heard_s
        self._period_s = 1.0 / settings.external_rate_hz
        self._refused = refused
        self._due_s = float("-inf")
        self._accepted_at_s = float("-inf")
        self._result: int | None = None
        self._unanswered = 0

    def tell(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        frame = moment.frame
        if moment.fix_inhibit_reason is not None or frame is None or moment.standby or self._result == _UNSUPPORTED:
            return []
        if moment.now_s < self._due_s:
            return []
        where = moment.locate(moment.arrives_s)
        if isinstance(where, NoEstimate):
            return []
        late = moment.now_s - self._due_s > self._period_s
        self._due_s = (moment.now_s if late else self._due_s) + self._period_s
        lat_deg, lon_deg, _ = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        sent_s = (moment.now_s - self._clock_began_s) % _WRAPS_S
        out: list[AidingMessage | Notice] = []
        if self._unanswered == _UNANSWERED and moment.on_air:
            out.append(Notice(moment.now_s, self._sysid, "warning", "it does not answer to external position estimates"))
        self._unanswered += 1
        return [*out, ExternalPosition(self._sysid, sent_s, lat_deg, lon_deg, horizontal_sigma_m(where.covariance))]

    def takes_them(self, now_s: float) -> bool:
        """Whether the vehicle takes the estimates, as it does while it dead-reckons."""
        return self._result == _ACCEPTED and now_s - self._accepted_at_s <= _LASTS_PERIODS * self._period_s

    def end(self) -> Sequence[AidingMessage]:
        """As the protocol says: the command cannot say that there is no position."""
        return []

    def answered(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says."""
        if result.command != COMMAND or result.result == _IN_PROGRESS:
            return []
        before, self._result, self._unanswered = self._result, result.result, 0
        if result.result == _ACCEPTED:
            self._accepted_at_s = result.received_at_s
            text = "it takes external position estimates"
            return [Notice(result.received_at_s, self._sysid, "info", text)] if before != _ACCEPTED else []
        word = _RESULTS.get(result.result, f"MAV_RESULT {result.result}")
        self._refused[f"external position estimate: {word} by the vehicle"] += 1
        if before == result.result:
            return []
        why = "its firmware does not know them" if result.result == _UNSUPPORTED else "its EKF uses a GPS, or has no origin yet"
        return [Notice(result.received_at_s, self._sysid, "warning", f"it refuses external position estimates ({word}): {why}")]

    def sends(self) -> str:
        """As the protocol says."""
        taken = "" if self._result == _ACCEPTED else ", not taken" if self._result is not None else ", not answered yet"
        return f"external position estimates{taken}"

    def sends_without_fix(self) -> str:
        """As the protocol says."""
        return "nothing"


class GpsInputOrExternalMethod:
    """GPS_INPUT, and external estimates beside it while its accuracy is beyond what the vehicle's EKF takes of a GPS.

    Once the vehicle takes the estimates it is certain that it does not use our GPS_INPUT: that goes on with fix_type 1, so that
    the two are never used in turns. Where it refuses them it uses a GPS: GPS_INPUT then goes on as it is.
    """

    def __init__(self, vehicle: Vehicle, settings: AidingSettings, parameters: Parameters, refused: Counter[str]) -> None:
        self._gps = GpsInputMethod(vehicle, settings)
        self._external = ExternalPositionMethod(vehicle, settings, refused)
        self.age_s = self._gps.age_s
        self._sysid = vehicle.sysid
        self._settings = settings
        self._parameters = parameters
        self._coarse: str | None = None
        self._changing_since_s: float | None = None
        self._by_external = False

    def tell(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the protocol says."""
        for name in (CHECK, SCALE):
            self._parameters.want(self._sysid, name, moment.now_s)
        (message,) = self._gps.tell(moment)
        assert isinstance(message, GpsInput)
        if moment.fix_inhibit_reason is not None or moment.standby:
            self._by_external = False
            return [message]
        out = self._judge(message, moment.now_s)
        self._by_external = False
        if self._coarse is not None:
            out.extend(self._external.tell(moment))
            self._by_external = self._external.takes_them(moment.now_s)
        stood_back = no_fix(self._sysid, message.gps_id, message.time_usec, message.gps_week, message.gps_time_of_week_ms)
        return [stood_back if self._by_external else message, *out]

    def end(self) -> Sequence[AidingMessage]:
        """As the protocol says."""
        return self._gps.end()

    def answered(self, result: CommandResult) -> Sequence[Notice]:
        """As the protocol says."""
        return self._external.answered(result)

    def sends(self) -> str:
        """As the protocol says."""
        if self._coarse is None:
            return self._gps.sends()
        if self._by_external:
            return f"{self._external.sends()}, for it is too coarse for GPS_INPUT: {self._coarse}"
        return f"{self._gps.sends()}, which its EKF may refuse: {self._coarse}"

    def sends_without_fix(self) -> str:
        """As the protocol says."""
        return self._gps.sends_without_fix()

    def _judge(self, message: GpsInput, now_s: float) -> list[AidingMessage | Notice]:
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
