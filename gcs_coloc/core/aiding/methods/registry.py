"""The registry of aiding methods; a vehicle's is chosen by the settings, else by its autopilot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gcs_coloc.core.aiding.acknowledgement import Acknowledgement, EkfAcknowledgement, FixAcknowledgement, FixFault
from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason
from gcs_coloc.core.aiding.methods.external_position import ExternalPositionMethod
from gcs_coloc.core.aiding.methods.gps_input import GpsInputMethod, GpsInputOrExternalMethod
from gcs_coloc.core.aiding.methods.method import AidingMethod, MethodContext
from gcs_coloc.core.aiding.methods.px4_positions import GlobalPositionSensorMethod, VisionPositionMethod
from gcs_coloc.core.aiding.methods.ranging_beacon import PERIOD_S, RangingBeaconMethod
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.reasons import StatedReason


@dataclass(frozen=True, slots=True)
class MethodEntry:
    """One aiding method: how to make it for a vehicle, and what it feeds there.

    `not_for_px4`, `not_for_ardupilot`: why it is none for that autopilot. `feeds_receiver`: a GPS receiver of the vehicle
    (GPS_INPUT). `unused`: the fault of a PX4's EKF2 that does not use it. `heeds_target`: only the vehicle that a message names
    heeds it, so that the method works behind a router. `period_s`: its own time between messages, s; None where the settings
    have it.
    """

    make: Callable[[MethodContext], AidingMethod]
    not_for_px4: InhibitReason | None = None
    not_for_ardupilot: InhibitReason | None = None
    feeds_receiver: bool = False
    unused: FixFault | None = None
    heeds_target: bool = False
    period_s: float | None = None

    def acknowledgement(self, gps_id: int, now_s: float) -> Acknowledgement | None:
        """Return what shows whether a vehicle uses what the method sends; None where only its answers do."""
        if self.feeds_receiver:
            return FixAcknowledgement(gps_id, now_s)
        return EkfAcknowledgement(self.unused) if self.unused is not None else None


METHODS: Mapping[AidingMethodName, MethodEntry] = {
    "auto": MethodEntry(GpsInputOrExternalMethod, InhibitReason.PX4_TAKES_NO_METHOD, feeds_receiver=True),
    "gps_input": MethodEntry(GpsInputMethod, InhibitReason.PX4_IGNORES_GPS_INPUT, feeds_receiver=True),
    "external_position": MethodEntry(ExternalPositionMethod, InhibitReason.PX4_RESETS_BY_EXTERNAL_POSITION, heeds_target=True),
    "global_position_sensor": MethodEntry(
        GlobalPositionSensorMethod, not_for_ardupilot=InhibitReason.ARDUPILOT_IGNORES_POSITION_SENSOR, unused=FixFault.EKF_UNAIDED
    ),
    "vision_position": MethodEntry(
        VisionPositionMethod, not_for_ardupilot=InhibitReason.VISION_IS_FOR_PX4, unused=FixFault.EKF_WITHOUT_VISION
    ),
    "ranging_beacon": MethodEntry(
        RangingBeaconMethod,
        not_for_ardupilot=InhibitReason.RANGING_BEACON_IS_FOR_PX4,
        unused=FixFault.EKF_WITHOUT_RANGES,
        period_s=PERIOD_S,
    ),
}
"""Every aiding method by its name in the settings; "auto" is the one for ArduPilot."""


def method_for(
    sysid: int, autopilot: Autopilot | None, settings: AidingSettings, px4: Callable[[int], AidingMethodName]
) -> AidingMethodName:
    """Return the method for a vehicle: the one set, else its autopilot's. `px4` gives that of a PX4.

    "auto" is ArduPilot's; it remains for a vehicle of which no method is known, which `mismatch` refuses.
    """
    name = settings.method_of(sysid)
    return px4(sysid) if name == "auto" and autopilot is Autopilot.PX4 else name


def mismatch(name: AidingMethodName, autopilot: Autopilot | None) -> Inhibit | None:
    """Return why a method is none for an autopilot; None where it is one, or the operator's own choice."""
    if autopilot is Autopilot.PX4:
        reason = METHODS[name].not_for_px4
    elif autopilot is Autopilot.ARDUPILOT:
        reason = METHODS[name].not_for_ardupilot
    else:
        reason = InhibitReason.UNKNOWN_AUTOPILOT if name == "auto" else None
    return StatedReason(reason) if reason is not None else None
