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

    `feeds_receiver`: a GPS receiver of the vehicle (GPS_INPUT). `feeds_ekf2`: PX4's EKF2. `heeds_target`: only the vehicle that
    a message names heeds it, so that the method works behind a router. `period_s`: its own time between messages, s; None where
    the settings have it.
    """

    make: Callable[[MethodContext], AidingMethod]
    feeds_receiver: bool = False
    feeds_ekf2: bool = False
    heeds_target: bool = False
    period_s: float | None = None


METHODS: Mapping[AidingMethodName, MethodEntry] = {
    "auto": MethodEntry(GpsInputOrExternalMethod, feeds_receiver=True),
    "gps_input": MethodEntry(GpsInputMethod, feeds_receiver=True),
    "external_position": MethodEntry(ExternalPositionMethod, heeds_target=True),
    "global_position_sensor": MethodEntry(GlobalPositionSensorMethod, feeds_ekf2=True),
    "vision_position": MethodEntry(VisionPositionMethod, feeds_ekf2=True),
    "ranging_beacon": MethodEntry(RangingBeaconMethod, feeds_ekf2=True, period_s=PERIOD_S),
}
"""Every aiding method by its name in the settings; "auto" is the one for ArduPilot."""


def method_for(
    sysid: int, autopilot: Autopilot | None, settings: AidingSettings, px4: Callable[[int], AidingMethodName]
) -> AidingMethodName:
    """Return the method for a vehicle: the one set, else its autopilot's. `px4` gives that of a PX4.

    "auto" is ArduPilot's; it remains for a vehicle of which no method is known, which `mismatch` refuses.
    """
    name = settings.methods.get(sysid, settings.method)
    return px4(sysid) if name == "auto" and autopilot is Autopilot.PX4 else name


def feeds_receiver(name: AidingMethodName) -> bool:
    """Return whether a method feeds a GPS receiver of the vehicle."""
    return METHODS[name].feeds_receiver


def acknowledgement_of(name: AidingMethodName, gps_id: int, now_s: float) -> Acknowledgement | None:
    """Return what shows whether a vehicle uses what a method sends; None where only its answers do."""
    if METHODS[name].feeds_receiver:
        return FixAcknowledgement(gps_id, now_s)
    return EkfAcknowledgement(_UNUSED.get(name, FixFault.EKF_UNAIDED)) if METHODS[name].feeds_ekf2 else None


_UNUSED: Mapping[AidingMethodName, FixFault] = {
    "vision_position": FixFault.EKF_WITHOUT_VISION,
    "ranging_beacon": FixFault.EKF_WITHOUT_RANGES,
}


def mismatch(name: AidingMethodName, autopilot: Autopilot | None) -> Inhibit | None:
    """Return why a method is none for an autopilot; None where it is one, or the operator's own choice."""
    if autopilot is Autopilot.PX4:
        reason = _NOT_FOR_PX4.get(name)
    elif autopilot is Autopilot.ARDUPILOT:
        reason = _NOT_FOR_ARDUPILOT.get(name)
    else:
        reason = InhibitReason.UNKNOWN_AUTOPILOT if name == "auto" else None
    return StatedReason(reason) if reason is not None else None


_NOT_FOR_PX4: Mapping[AidingMethodName, InhibitReason] = {
    "auto": InhibitReason.PX4_TAKES_NO_METHOD,
    "gps_input": InhibitReason.PX4_IGNORES_GPS_INPUT,
    "external_position": InhibitReason.PX4_RESETS_BY_EXTERNAL_POSITION,
}
_NOT_FOR_ARDUPILOT: Mapping[AidingMethodName, InhibitReason] = {
    "global_position_sensor": InhibitReason.ARDUPILOT_IGNORES_POSITION_SENSOR,
    "vision_position": InhibitReason.VISION_IS_FOR_PX4,
    "ranging_beacon": InhibitReason.RANGING_BEACON_IS_FOR_PX4,
}
