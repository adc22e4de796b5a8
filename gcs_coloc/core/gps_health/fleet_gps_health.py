"""The GPS health of all vehicles of a fleet: one state machine each."""

from __future__ import annotations

from gcs_coloc.core.gps_health.evidence import GpsEvidence
from gcs_coloc.core.gps_health.gps_health import GpsHealth, GpsHealthSettings, GpsState
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.inbound import GlobalPosition, GpsReceiver
from gcs_coloc.core.messages.outbound import HealthChanged


class FleetGpsHealth:
    """The GPS health of each vehicle; a vehicle of which nothing was heard is UNKNOWN."""

    def __init__(self, settings: GpsHealthSettings) -> None:
        self._settings = settings
        self._machines: dict[int, GpsHealth] = {}

    def add_receiver(self, fix: GpsReceiver, position: GlobalPosition | None) -> None:
        """Add a report of a vehicle's own receiver, with the position that its autopilot reported last."""
        self._of(fix.sysid).add_receiver(fix, position)

    def add_position(self, reported: PositionMeasurement, *, own: bool) -> None:
        """Add the position that an autopilot reports. `own` is False while the vehicle is aided."""
        self._of(reported.vehicle).add_position(reported, own=own)

    def update(self, sysid: int, evidence: GpsEvidence, now_s: float) -> HealthChanged | None:
        """Move the machine of one vehicle on to `now_s`; return the change of its state, None where there is none."""
        machine = self._of(sysid)
        before = machine.state
        if not machine.update(evidence, now_s):
            return None
        return HealthChanged(now_s, sysid, before.value, machine.state.value, machine.reason.text)

    def state(self, sysid: int) -> GpsState:
        """Return the state of a vehicle since its last update."""
        return self._of(sysid).state

    def is_returning(self, sysid: int) -> bool:
        """Return whether a vehicle that has failed has good evidence again."""
        return self._of(sysid).is_returning

    def reports_false_fix(self, sysid: int) -> bool:
        """Return whether the receiver of a FAILED vehicle reports a fix all the same, or one that came and went."""
        return self._of(sysid).reports_false_fix

    def may_witness(self, sysid: int) -> bool:
        """Return whether nothing speaks against a vehicle but, at most, ranges that leave open who is at fault."""
        return self._of(sysid).may_witness

    def is_doubtful(self, sysid: int, now_s: float) -> bool:
        """Return whether a vehicle's receiver speaks against itself, where ranges leave open who is at fault."""
        return self._of(sysid).is_doubtful(now_s)

    def reason(self, sysid: int) -> str:
        """Return what speaks for the state, in words."""
        return self._of(sysid).reason.text

    def _of(self, sysid: int) -> GpsHealth:
        machine = self._machines.get(sysid)
        if machine is None:
            machine = self._machines[sysid] = GpsHealth(self._settings)
        return machine
