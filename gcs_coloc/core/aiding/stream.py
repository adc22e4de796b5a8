"""The stream of aid to one vehicle: its steady schedule, the policy on its fixes, and what became of it at the other end."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from math import sqrt

from gcs_coloc.core.aiding.acknowledgement import FixAcknowledgement
from gcs_coloc.core.aiding.fix_policy import FixPolicy
from gcs_coloc.core.aiding.method_choice import feeds_receiver
from gcs_coloc.core.aiding.methods import AidingMethod, Moment
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.core.messages.outbound import GpsInput, Notice, Outbound
from gcs_coloc.core.telemetry.vehicles import FixSent, Vehicle
from gcs_coloc.core.tick_schedule import TickSchedule

_LONGEST_LEAD_S = 0.5  # beyond, a prediction is worth less than the delay costs
_FIRST_REPORT_S = 1.0
_WATCHED_RECEIVERS = 2  # GPS_RAW_INT and GPS2_RAW: of a third no message tells

Answer = Callable[[int, float], Estimate | NoEstimate]


class Purpose(Enum):
    """Why a vehicle has a stream."""

    AID = "aid"
    HAND_BACK = "handing back"
    STANDBY = "standby"


class AidingStream:
    """The stream to one vehicle. `fix_inhibit_reason`: why the last message had no fix; `acknowledgement`: is it used?

    `on_air`: what is told is sent; else what the vehicle says of its receiver is no answer to it, and `acknowledgement` is None.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        name: AidingMethodName,
        way: AidingMethod,
        settings: AidingSettings,
        now_s: float,
        purpose: Purpose,
        grid: TickSchedule,
        *,
        on_air: bool = True,
    ) -> None:
        self.vehicle = vehicle
        self.name = name
        self.way = way
        self.purpose = purpose
        self.purpose_since_s = now_s
        self.due_s = now_s
        self.fix_inhibit_reason: str | None = "not sent yet"
        self.flickered = False
        self._grid = grid
        self._on_air = on_air
        watched = on_air and feeds_receiver(name) and settings.gps_id < _WATCHED_RECEIVERS
        self.acknowledgement = FixAcknowledgement(settings.gps_id, now_s) if watched else None
        self._policy = FixPolicy(settings, now_s)
        self._period_s = 1.0 / settings.rate_hz
        self._sent = 0

    def tick(self, now_s: float, frame: LocalFrame | None, utc_minus_service_s: float | None, answer: Answer) -> list[Outbound]:
        """What is due by `now_s`: the way's messages, and a notice where the fix is gained or lost.

        Deadlines keep the fleet's grid, so that all vehicles' are due at once; those that a late call has missed are left out,
        never caught up with. The vehicle takes the data to be `age_s` old when they arrive, so that they are for as much later as
        the link is known to take at least; what a message takes longer, a driver finds by the time in it.
        """
        if now_s < self.due_s:
            return []
        self.due_s = self._grid.after(now_s, self._period_s)
        vehicle = self.vehicle
        arrives_s = now_s + min(vehicle.clock.one_way_delay_s(now_s) or 0.0, _LONGEST_LEAD_S)
        where = answer(vehicle.sysid, arrives_s - self.way.age_s)
        if isinstance(where, NoEstimate) and self.purpose is not Purpose.AID and now_s - self.purpose_since_s < _FIRST_REPORT_S:
            # Trusted again, it has not reported yet: a message left out is less than the word that there is no fix.
            return []
        reason = self._policy.why_no_fix(
            where,
            now_s,
            own_gps=vehicle.health.trusted,
            air_data=vehicle.has_air_data(now_s),
            range_misfit=vehicle.range_misfit,
            range_jump_m=vehicle.range_jump_m,
        )
        if reason is None and self._on_air and isinstance(where, Estimate):
            vehicle.fix_sent = FixSent(now_s, sqrt(float(where.covariance[2, 2])))
        moment = Moment(
            now_s=now_s,
            arrives_s=arrives_s,
            frame=frame,
            utc_minus_service_s=utc_minus_service_s,
            where=where,
            fix_inhibit_reason=reason,
            locate=lambda at_s: answer(vehicle.sysid, at_s),
            standby=self.purpose is not Purpose.AID,
            on_air=self._on_air,
        )
        out: list[Outbound] = list(self.way.tell(moment))
        for message in out:
            if self.acknowledgement is not None and isinstance(message, GpsInput):
                self.acknowledgement.sent(message, now_s)
        return out + self._tell(reason, now_s)

    def status(self) -> str:
        """What is sent in a few words, for the operator."""
        lead = "sending" if self.purpose is Purpose.AID else f"{self.purpose.value}: sending"
        if self.fix_inhibit_reason is not None:
            return f"{lead} {self.way.sends_without_fix()}: {self.fix_inhibit_reason}"
        fault = self.acknowledgement.fault if self.acknowledgement is not None else None
        return f"{lead} {self.way.sends()}" + (f", NOT TAKEN: {fault}" if fault is not None else "")

    def _tell(self, reason: str | None, now_s: float) -> list[Outbound]:
        had_fix, has_fix = self.fix_inhibit_reason is None, reason is None
        self.fix_inhibit_reason = reason
        first, self._sent = self._sent == 0, self._sent + 1
        if has_fix and not had_fix:
            return [Notice(now_s, self.vehicle.sysid, "info", "located: sending positions")]
        if not has_fix and (had_fix or first):
            text = f"not located, sending {self.way.sends_without_fix()}: {reason}"
            return [Notice(now_s, self.vehicle.sysid, "warning", text)]
        return []
