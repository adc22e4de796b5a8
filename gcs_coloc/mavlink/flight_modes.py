"""Names of flight modes as ground stations show them, by autopilot, type of vehicle and the custom mode of HEARTBEAT."""

from __future__ import annotations

from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.measurements import VehicleClass

_ROVERS = frozenset((mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT))
WINGED = frozenset((mavlink.MAV_TYPE_FIXED_WING, *range(19, 26)))
"""MAV_TYPEs that fly along their nose and turn by banking; from 19 on VTOLs, whose airspeed is next to none while they hover."""
_HOVERING = (2, 3, 4, 13, 14, 15, 29, 35)
"""MAV_TYPEs of multirotors and helicopters, by number: older pymavlinks lack some of the names."""
_BOATS = (mavlink.MAV_TYPE_SURFACE_BOAT, mavlink.MAV_TYPE_SUBMARINE)
VEHICLE_CLASSES: Mapping[int, VehicleClass] = {
    **dict.fromkeys(WINGED, VehicleClass.PLANE),
    **dict.fromkeys(_HOVERING, VehicleClass.MULTIROTOR),
    **dict.fromkeys(_BOATS, VehicleClass.BOAT),
    mavlink.MAV_TYPE_GROUND_ROVER: VehicleClass.GROUND,
}
"""Classes of vehicles by MAV_TYPE."""
_PX4_MODES = ("?", "MANUAL", "ALTCTL", "POSCTL", "AUTO", "ACRO", "OFFBOARD", "STABILIZED", "RATTITUDE")
"""PX4 px4_custom_mode.h, PX4_CUSTOM_MAIN_MODE: the third byte of the custom mode."""
_PX4_AUTO_MODES = ("AUTO", "READY", "TAKEOFF", "LOITER", "MISSION", "RTL", "LAND", "AUTO", "FOLLOW", "PRECLAND")
"""PX4 px4_custom_mode.h, PX4_CUSTOM_SUB_MODE_AUTO: the fourth byte, where the main mode is AUTO."""


def _names(enumeration: str) -> dict[int, str]:
    entries = mavlink.enums[enumeration].items()
    return {value: entry.name.removeprefix(f"{enumeration}_") for value, entry in entries if not entry.name.endswith("_ENUM_END")}


_PLANE_MODES, _COPTER_MODES, _ROVER_MODES = _names("PLANE_MODE"), _names("COPTER_MODE"), _names("ROVER_MODE")


def ardupilot_mode(vehicle_type: int, custom_mode: int) -> str:
    """The name of a mode of ArduPilot: PLANE_MODE, ROVER_MODE or COPTER_MODE by MAV_TYPE; the number where it has none."""
    modes: Mapping[int, str] = (
        _PLANE_MODES if vehicle_type in WINGED else _ROVER_MODES if vehicle_type in _ROVERS else _COPTER_MODES
    )
    return modes.get(custom_mode, str(custom_mode))


def px4_mode(custom_mode: int) -> str:
    """The name of a mode of PX4; the number where it has none."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if not 0 < main < len(_PX4_MODES):
        return str(custom_mode)
    return _PX4_AUTO_MODES[sub] if _PX4_MODES[main] == "AUTO" and sub < len(_PX4_AUTO_MODES) else _PX4_MODES[main]
