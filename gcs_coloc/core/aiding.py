"""Who is aided and when: the policy and the steady schedule of GPS_INPUT, one stream per aided vehicle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gcs_coloc.core.fleet import Vehicle
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_input import AidSettings, gps_input, no_fix, why_no_fix
from gcs_coloc.core.health import GpsState
from gcs_coloc.core.measurements import Estimate, Unknown
from gcs_coloc.core.messages import AidWord, Autopilot, GpsInput, Notice, Outbound

_LONGEST_LEAD_S = 0.5  # beyond, a prediction is worth less than the delay costs
_AIDED_STATES = (GpsState.FAILED, GpsState.RECOVERING)


@dataclass(slots=True)
class _Stream:
    """The stream of aid to one vehicle: when the next message is due, and why the last one carried no fix."""

    vehicle: Vehicle
    due_s: float
    no_fix_because: str | None = "not sent yet"
    sent: int = 0


class Aiding:
    """Keeps one stream of GPS_INPUT for each vehicle that is to be aided and can be reached.

    `withheld` says why nobody may be aided at all, or is None. `words` is what the operator decided, by system id.
    """

    def __init__(self, settings: AidSettings) -> None:
        self.settings = settings
        self.withheld: str | None = None
        self.words: dict[int, AidWord] = {}
        self._period_s = 1.0 / settings.rate_hz
        self._streams: dict[int, _Stream] = {}
        self._told: dict[int, str | None] = {}

    def review(self, vehicle: Vehicle, now_s: float) -> list[Outbound]:
        """Start or end the stream of one vehicle after its health, autopilot or route changed."""
        wanted, hindrance = self._wanted(vehicle), self.hindrance(vehicle)
        aided = wanted and hindrance is None
        stream = self._streams.get(vehicle.sysid)
        out: list[Outbound] = []
        if aided and stream is None:
            self._streams[vehicle.sysid] = _Stream(vehicle, due_s=now_s)
            vehicle.health.aided = True
        elif not aided and stream is not None:
            del self._streams[vehicle.sysid]
            vehicle.health.aided = False
            out.append(no_fix(vehicle.sysid, self.settings.gps_id))
            why = "the operator's word" if self._word(vehicle) is AidWord.OFF else f"GPS {vehicle.health.state.value}"
            out.append(Notice(now_s, vehicle.sysid, "info", f"aid ended: {hindrance or why}"))
        # Put under aid with a good receiver of its own, it may fly on ours: what it claims must not come back as evidence.
        vehicle.health.captive = self._word(vehicle) is AidWord.ON
        if wanted and hindrance != self._told.get(vehicle.sysid):
            self._told[vehicle.sysid] = hindrance
            if hindrance is not None:
                out.append(Notice(now_s, vehicle.sysid, "error", f"needs aid and cannot be aided: {hindrance}"))
        return out

    def hindrance(self, vehicle: Vehicle) -> str | None:
        """Why a vehicle cannot be aided even if it should be, in words for the operator; None where it can."""
        if vehicle.blocked is not None:
            return vehicle.blocked
        if self.withheld is not None:
            return self.withheld
        if vehicle.autopilot is Autopilot.PX4:
            return "PX4 does not take GPS_INPUT: nothing is sent"
        return None

    def due(
        self,
        now_s: float,
        frame: LocalFrame | None,
        utc_minus_service_s: float | None,
        answer: Callable[[int, float], Estimate | Unknown],
    ) -> list[Outbound]:
        """The GPS_INPUT messages that are due by `now_s`, with a notice where a stream gains or loses its fix.

        `answer` is the estimator's: where a vehicle is at a service time. Deadlines keep a fixed grid; those that a
        late call has missed are left out, never caught up with. The vehicle takes the data to be `lag_s` old when they
        arrive, so that they are for as much later as the link is known to take at least; what a message takes longer, its
        driver finds by the time in it.
        """
        out: list[Outbound] = []
        for sysid, stream in self._streams.items():
            if now_s < stream.due_s:
                continue
            under_way_s = min(stream.vehicle.clock.one_way_delay_s(now_s) or 0.0, _LONGEST_LEAD_S)
            at_s = now_s + under_way_s - self.settings.lag_s
            unix_s = at_s + utc_minus_service_s if utc_minus_service_s is not None else None
            missed = int((now_s - stream.due_s) / self._period_s)
            stream.due_s += (missed + 1) * self._period_s
            where = answer(sysid, at_s)
            out.append(gps_input(sysid, where, frame, stream.vehicle.range_error_m, unix_s, self.settings))
            out.extend(self._tell(sysid, stream, why_no_fix(where, self.settings), now_s))
            stream.sent += 1
        return out

    def next_due_s(self) -> float:
        """When the next message is due; infinity where nobody is aided."""
        return min((stream.due_s for stream in self._streams.values()), default=float("inf"))

    def status(self, vehicle: Vehicle) -> str:
        """The state of a vehicle's aid in a few words, for the operator."""
        stream = self._streams.get(vehicle.sysid)
        if stream is not None:
            return "sending 3D fix" if stream.no_fix_because is None else f"sending no fix: {stream.no_fix_because}"
        if self._wanted(vehicle):
            return f"NOT SENT: {self.hindrance(vehicle)}"
        return "off" if self._word(vehicle) is not AidWord.OFF else "off by the operator's word"

    def sends_fix(self, sysid: int) -> bool:
        """Whether a vehicle is being sent a position, and not only the word that there is none."""
        stream = self._streams.get(sysid)
        return stream is not None and stream.no_fix_because is None

    def close(self) -> list[GpsInput]:
        """End every stream: a last message with fix_type 1 for each vehicle that is being aided."""
        last = [no_fix(sysid, self.settings.gps_id) for sysid in self._streams]
        self._streams.clear()
        return last

    def _word(self, vehicle: Vehicle) -> AidWord:
        return self.words.get(vehicle.sysid, AidWord.AUTO)

    def _wanted(self, vehicle: Vehicle) -> bool:
        word = self._word(vehicle)
        return word is AidWord.ON or (word is AidWord.AUTO and vehicle.health.state in _AIDED_STATES)

    def _tell(self, sysid: int, stream: _Stream, reason: str | None, now_s: float) -> list[Notice]:
        had_fix, has_fix = stream.no_fix_because is None, reason is None
        stream.no_fix_because = reason
        if has_fix and not had_fix:
            return [Notice(now_s, sysid, "info", "located: sending positions")]
        if not has_fix and (had_fix or stream.sent == 0):
            return [Notice(now_s, sysid, "warning", f"not located, sending fix_type 1: {reason}")]
        return []
