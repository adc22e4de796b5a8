"""Which way to aid is for which vehicle: by the settings, and where these leave it open by its autopilot."""

from __future__ import annotations

from collections import Counter

from gcs_coloc.core.aiding.external_position import ExternalPositionMethod, GpsInputOrExternalMethod
from gcs_coloc.core.aiding.methods import AidingMethod, GlobalPositionSensorMethod, GpsInputMethod
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.core.telemetry.vehicles import Vehicle


def method_name(vehicle: Vehicle, settings: AidingSettings) -> AidingMethodName:
    """As `method_for`."""
    return method_for(vehicle.sysid, vehicle.autopilot, settings)


def method_for(sysid: int, autopilot: Autopilot | None, settings: AidingSettings) -> AidingMethodName:
    """The way for a vehicle; "auto" remains for ArduPilot: GPS_INPUT, with external estimates where that is too coarse.

    It also remains for an autopilot that nobody knows to take any of them, for which it is none (`mismatch`).
    """
    name = settings.methods.get(sysid, settings.method)
    return "global_position_sensor" if name == "auto" and autopilot is Autopilot.PX4 else name


def feeds_receiver(name: AidingMethodName) -> bool:
    """Whether a way feeds a GPS receiver of the vehicle's (GPS_INPUT)."""
    return name in ("auto", "gps_input")


def mismatch(name: AidingMethodName, autopilot: Autopilot | None) -> str | None:
    """Why a way is none for an autopilot, in words for the operator; None where it is one, or the operator's own choice."""
    if name == "auto" and autopilot is not Autopilot.ARDUPILOT:
        return (
            "its autopilot is neither ArduPilot nor PX4, and nobody knows what it takes: "
            "where you have tried one, set its aiding method ([aiding] methods)"
        )
    if autopilot is Autopilot.PX4 and feeds_receiver(name):
        return "PX4 does not take GPS_INPUT: set its aiding method to auto or global_position_sensor"
    if autopilot is Autopilot.ARDUPILOT and name == "global_position_sensor":
        return "ArduPilot does not take GLOBAL_POSITION_SENSOR: set its aiding method to auto or gps_input"
    return None


def make_method(
    name: AidingMethodName, vehicle: Vehicle, settings: AidingSettings, parameters: Parameters, refused: Counter[str]
) -> AidingMethod:
    """A fresh way for one vehicle. `refused` counts what the vehicle refuses, by reason."""
    if name == "gps_input":
        return GpsInputMethod(vehicle, settings)
    if name == "external_position":
        return ExternalPositionMethod(vehicle, settings, refused)
    if name == "global_position_sensor":
        return GlobalPositionSensorMethod(vehicle)
    return GpsInputOrExternalMethod(vehicle, settings, parameters, refused)
