"""HEARTBEAT: the autopilot, the vehicle class and the name of the flight mode.

The class is by the type of vehicle. The name is the one that ground stations show.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat

_AUTOPILOTS = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: Autopilot.ARDUPILOT,
    mavlink.MAV_AUTOPILOT_PX4: Autopilot.PX4,
}
_NO_VEHICLES = frozenset((6, 18, 26, 27, *range(30, 35), *range(36, 43), 44, 48, 49))
"""MAV_TYPEs of ground stations and of parts of a vehicle: companion computers (18), gimbals (26), ADS-B (27), cameras (30) and so
on, the newest a radio (49). Many of them name an autopilot in their HEARTBEAT that they are not. By number: older pymavlinks
lack some of the names."""
_ROVERS = frozenset((mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT))
_WINGED = frozenset((mavlink.MAV_TYPE_FIXED_WING, *range(19, 26)))
"""MAV_TYPEs that fly along their nose and turn by banking; from 19 on VTOLs, whose airspeed is next to none while they hover."""
_HOVERING = (2, 3, 4, 13, 14, 15, 29, 35, 43)
"""MAV_TYPEs of multirotors and helicopters, by number: older pymavlinks lack some of the names."""
_BOATS = (mavlink.MAV_TYPE_SURFACE_BOAT, mavlink.MAV_TYPE_SUBMARINE)
_VEHICLE_CLASSES: Mapping[int, VehicleClass] = {
    **dict.fromkeys(_WINGED, VehicleClass.PLANE),
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


_PLANE_MODES, _COPTER_MODES, _ROVER_MODES, _SUB_MODES = map(_names, ("PLANE_MODE", "COPTER_MODE", "ROVER_MODE", "SUB_MODE"))


def heartbeat(sysid: int, received_at_s: float, values: tuple[Any, ...]) -> Heartbeat | None:
    """HEARTBEAT (0); None where the sender is no autopilot.

    Such a sender is a ground station, a companion computer or a camera.
    """
    custom_mode, vehicle_type, autopilot, base_mode, _system_status, _version = values
    if autopilot == mavlink.MAV_AUTOPILOT_INVALID or vehicle_type in _NO_VEHICLES:
        return None
    is_px4, is_ardupilot = autopilot == mavlink.MAV_AUTOPILOT_PX4, autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    return Heartbeat(
        sysid=sysid,
        received_at_s=received_at_s,
        autopilot=_AUTOPILOTS.get(autopilot, Autopilot.OTHER),
        armed=bool(base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
        winged=vehicle_type in _WINGED,
        mode=px4_mode(custom_mode) if is_px4 else ardupilot_mode(vehicle_type, custom_mode) if is_ardupilot else str(custom_mode),
        vehicle_class=_VEHICLE_CLASSES.get(vehicle_type),
    )


def ardupilot_mode(vehicle_type: int, custom_mode: int) -> str:
    """Return the name of a flight mode of ArduPilot; the number as text where it has none.

    It is of PLANE_MODE, ROVER_MODE, SUB_MODE or COPTER_MODE, by MAV_TYPE.
    """
    if vehicle_type in _WINGED:
        modes = _PLANE_MODES
    elif vehicle_type in _ROVERS:
        modes = _ROVER_MODES
    else:
        modes = _SUB_MODES if vehicle_type == mavlink.MAV_TYPE_SUBMARINE else _COPTER_MODES
    return modes.get(custom_mode, str(custom_mode))


def px4_mode(custom_mode: int) -> str:
    """Return the name of a flight mode of PX4; the number as text where it has none."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if not 0 < main < len(_PX4_MODES):
        return str(custom_mode)
    return _PX4_AUTO_MODES[sub] if _PX4_MODES[main] == "AUTO" and sub < len(_PX4_AUTO_MODES) else _PX4_MODES[main]
