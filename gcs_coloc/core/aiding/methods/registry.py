"""The registry of aiding methods; a vehicle's is chosen by the settings, else by its autopilot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gcs_coloc.core.aiding.inhibit import Inhibit, InhibitReason
from gcs_coloc.core.aiding.methods.external_position import ExternalPositionMethod
from gcs_coloc.core.aiding.methods.global_position_sensor import GlobalPositionSensorMethod
from gcs_coloc.core.aiding.methods.gps_input import GpsInputMethod, GpsInputOrExternalMethod
from gcs_coloc.core.aiding.methods.method import AidingMethod, MethodContext
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.reasons import StatedReason


@dataclass(frozen=True, slots=True)
class MethodEntry:
    """One method: how to make it for a vehicle, and whether it feeds a GPS receiver of the vehicle (GPS_INPUT)."""

    make: Callable[[MethodContext], AidingMethod]
    feeds_receiver: bool = False


METHODS: Mapping[AidingMethodName, MethodEntry] = {
    "auto": MethodEntry(GpsInputOrExternalMethod, feeds_receiver=True),
    "gps_input": MethodEntry(GpsInputMethod, feeds_receiver=True),
    "external_position": MethodEntry(ExternalPositionMethod),
    "global_position_sensor": MethodEntry(GlobalPositionSensorMethod),
}
"""Every aiding method by its name in the settings; "auto" is the one for ArduPilot."""


def method_for(sysid: int, autopilot: Autopilot | None, settings: AidingSettings) -> AidingMethodName:
    """Return the method for a vehicle; "auto" remains for every autopilot but PX4, and `mismatch` refuses it for unknown ones."""
    name = settings.methods.get(sysid, settings.method)
    return "global_position_sensor" if name == "auto" and autopilot is Autopilot.PX4 else name


def feeds_receiver(name: AidingMethodName) -> bool:
    """Return whether a method feeds a GPS receiver of the vehicle."""
    return METHODS[name].feeds_receiver


def mismatch(name: AidingMethodName, autopilot: Autopilot | None) -> Inhibit | None:
    """Return why a method is none for an autopilot; None where it is one, or the operator's own choice."""
    if name == "auto" and autopilot is not Autopilot.ARDUPILOT:
        return StatedReason(InhibitReason.UNKNOWN_AUTOPILOT)
    if autopilot is Autopilot.PX4 and feeds_receiver(name):
        return StatedReason(InhibitReason.PX4_IGNORES_GPS_INPUT)
    if autopilot is Autopilot.ARDUPILOT and name == "global_position_sensor":
        return StatedReason(InhibitReason.ARDUPILOT_IGNORES_POSITION_SENSOR)
    return None
