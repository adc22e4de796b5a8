"""External position estimates: a command that ArduPilot accepts while it dead-reckons.

EKF3 refuses a GPS whose stated accuracy is coarse, and drifts on. It accepts a coarse position by
MAV_CMD_EXTERNAL_POSITION_ESTIMATE, and only while it uses no GPS: so its answer shows whether it uses what GPS_INPUT brings.
"""

from __future__ import annotations

from collections.abc import Sequence

from gcs_coloc.core.aiding.methods.method import AidingMethod, MethodContext, Moment
from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import NoEstimate
from gcs_coloc.core.messages.inbound import CommandOutcome, CommandResult, VehicleCommand
from gcs_coloc.core.messages.outbound import AidingMessage, ExternalPosition, Notice
from gcs_coloc.core.reasons import CoreRefusal

_REFUSALS = {
    CommandOutcome.TEMPORARILY_REJECTED: CoreRefusal.EXTERNAL_POSITION_REJECTED,
    CommandOutcome.DENIED: CoreRefusal.EXTERNAL_POSITION_DENIED,
    CommandOutcome.UNSUPPORTED: CoreRefusal.EXTERNAL_POSITION_UNSUPPORTED,
    CommandOutcome.FAILED: CoreRefusal.EXTERNAL_POSITION_FAILED,
    CommandOutcome.OTHER: CoreRefusal.EXTERNAL_POSITION_OTHER,
}
_MAX_UNANSWERED = 5  # chosen: five seconds at the default rate
_ACCEPTED_PERIODS = 3.5  # an acceptance holds for so long; chosen: three lost answers
_WRAPS_S = 32_768.0  # param1 is a 32-bit float: 2 ms apart here


class ExternalPositionMethod(AidingMethod):
    """MAV_CMD_EXTERNAL_POSITION_ESTIMATE at a low rate, its answers watched."""

    def __init__(self, context: MethodContext) -> None:
        super().__init__(context)
        self._clock_began_s = context.first_heard_s
        self._period_s = 1.0 / context.settings.external_rate_hz
        self._refused = context.refused
        self._due_s = float("-inf")
        self._accepted_at_s = float("-inf")
        self._outcome: CommandOutcome | None = None
        self._unanswered = 0

    def build_messages(self, moment: Moment) -> Sequence[AidingMessage | Notice]:
        """As the base says."""
        frame = moment.frame
        if moment.inhibit is not None or frame is None or moment.standby or self._outcome is CommandOutcome.UNSUPPORTED:
            return []
        if moment.now_s < self._due_s:
            return []
        where = moment.known.locate_node(self._sysid, moment.arrives_s)
        if isinstance(where, NoEstimate):
            return []
        late = moment.now_s - self._due_s > self._period_s
        self._due_s = (moment.now_s if late else self._due_s) + self._period_s
        lat_deg, lon_deg, _ = frame.geodetic_from_enu(*(float(x) for x in where.position_enu_m))
        sent_s = (moment.now_s - self._clock_began_s) % _WRAPS_S
        out: list[AidingMessage | Notice] = []
        if self._unanswered == _MAX_UNANSWERED and moment.transmits:
            out.append(Notice(moment.now_s, self._sysid, "warning", "it does not answer to external position estimates"))
        self._unanswered += 1
        return [*out, ExternalPosition(self._sysid, sent_s, lat_deg, lon_deg, horizontal_sigma_m(where.covariance))]

    def is_accepted(self, now_s: float) -> bool:
        """Return whether the vehicle accepts the estimates, as it does while it dead-reckons."""
        return self._outcome is CommandOutcome.ACCEPTED and now_s - self._accepted_at_s <= _ACCEPTED_PERIODS * self._period_s

    def add_result(self, result: CommandResult) -> Sequence[Notice]:
        """As the base says."""
        outcome = result.outcome
        if result.command is not VehicleCommand.EXTERNAL_POSITION_ESTIMATE or outcome is CommandOutcome.IN_PROGRESS:
            return []
        is_new, self._outcome, self._unanswered = outcome is not self._outcome, outcome, 0
        level, text = "info", "it takes external position estimates"
        if outcome is CommandOutcome.ACCEPTED:
            self._accepted_at_s = result.received_at_s
        else:
            self._refused[_REFUSALS[outcome]] += 1
            unknown = outcome is CommandOutcome.UNSUPPORTED
            why = "its firmware does not know them" if unknown else "its EKF uses a GPS, or has no origin yet"
            level, text = "warning", f"it refuses external position estimates ({outcome.value}): {why}"
        return [Notice(result.received_at_s, self._sysid, level, text)] if is_new else []

    def with_fix(self) -> str:
        """As the base says."""
        if self._outcome is CommandOutcome.ACCEPTED:
            return "external position estimates"
        return f"external position estimates, not {'taken' if self._outcome is not None else 'answered yet'}"
