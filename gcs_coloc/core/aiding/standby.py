"""Standby: a healthy vehicle is streamed its own estimate, so that it can arm with a MAVLink receiver and fails over without a
gap.

It is safe only while the autopilot stays with its own receiver: one that may change over to ours would report our estimate as
its own position, which would then hold itself up. So its parameters are read first.
"""

from __future__ import annotations

from gcs_coloc.core.aiding.methods.registry import feeds_receiver, method_for
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.primary_switch import NAME as PRIMARY
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.messages.outbound import Notice

AUTO_SWITCH = "GPS_AUTO_SWITCH"
_STAYS_WITH_ITS_OWN = (0.0, 4.0)  # the primary receiver only; the primary one while it has a 3D fix
_STREAMED_IN = (GpsState.HEALTHY, GpsState.SUSPECT)


class Standby:
    """Who of one fleet is to be streamed on standby, and what stands against it."""

    def __init__(self, settings: AidingSettings, parameters: Parameters) -> None:
        self._settings = settings
        self._parameters = parameters
        self._obstacles: dict[int, str] = {}

    def is_for(self, sysid: int, autopilot: Autopilot | None, gps_state: GpsState) -> bool:
        """Whether a vehicle that needs no aid is to have a stream; any other method than GPS_INPUT would be fused at once."""
        wanted = self._settings.standby and gps_state in _STREAMED_IN
        return wanted and feeds_receiver(method_for(sysid, autopilot, self._settings))

    def obstacle(self, sysid: int, now_s: float) -> tuple[str | None, list[Notice]]:
        """Why a vehicle gets no stream on standby, None where it may, and what is new of that to tell."""
        for name in (AUTO_SWITCH, PRIMARY):
            self._parameters.request(sysid, name, now_s)
        text, before = self._why(sysid), self._obstacles.get(sysid)
        if text is None:
            self._obstacles.pop(sysid, None)
            return None, []
        self._obstacles[sysid] = text
        if text == before or self._parameters.value(sysid, AUTO_SWITCH) is None:
            return text, []
        return text, [Notice(now_s, sysid, "warning", f"no standby: {text}")]

    def status(self, sysid: int) -> str | None:
        """Why a vehicle has no stream on standby, for the operator; None where nothing stands against it."""
        text = self._obstacles.get(sysid)
        return f"no standby: {text}" if text is not None else None

    def _why(self, sysid: int) -> str | None:
        switching, primary = (self._parameters.value(sysid, name) for name in (AUTO_SWITCH, PRIMARY))
        if switching is None or primary is None:
            return f"it has not told its {AUTO_SWITCH} and {PRIMARY} yet"
        if primary == self._settings.gps_id:
            return f"{PRIMARY}={primary:g} is our receiver: set it to its own"
        if switching not in _STAYS_WITH_ITS_OWN:
            return f"{AUTO_SWITCH}={switching:g} could leave its own receiver for ours: set it to 4"
        return None
