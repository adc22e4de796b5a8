"""The faults in force on one vehicle: of the scenario, of commands, and of its SIM_ parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable

from sitl_fakes.faults import Fault, GpsJammed, GpsLost, GpsSpoofed
from sitl_fakes.parameters import Parameters

_METRES_PER_DEGREE = 111_319.49
_HARMLESS = {"SIM_GPS1_ENABLE": 1.0, "SIM_GPS1_JAM": 0.0, "SIM_GPS1_GLTCH_X": 0.0, "SIM_GPS1_GLTCH_Y": 0.0}


class ActiveFaults:
    """The faults of one vehicle. `origin_lat_deg` turns a glitch in degrees of longitude into metres."""

    def __init__(self, sysid: int, faults: Iterable[Fault], params: Parameters, origin_lat_deg: float) -> None:
        self._sysid = sysid
        self._faults = [f for f in faults if f.vehicle == sysid]
        self._params = params
        self._east_m_per_deg = _METRES_PER_DEGREE * math.cos(math.radians(origin_lat_deg))

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        self._faults.append(fault)

    def remove(self, fault: Fault) -> None:
        """Remove a fault that has had its effect."""
        self._faults.remove(fault)

    def clear(self, at_s: float) -> None:
        """End every fault in force, also by parameter; those to come stay."""
        self._faults = [f for f in self._faults if not f.active(at_s)]
        for name, harmless in _HARMLESS.items():
            if name in self._params:
                self._params.set(name, harmless)

    def active(self, at_s: float) -> list[Fault]:
        """Faults in force at a time (s)."""
        active = [f for f in self._faults if f.active(at_s)]
        simulated = {name: self._params.get(name, harmless) for name, harmless in _HARMLESS.items()}
        if simulated["SIM_GPS1_ENABLE"] == 0:
            active.append(GpsLost(vehicle=self._sysid, at_s=at_s))
        if simulated["SIM_GPS1_JAM"] != 0:
            active.append(GpsJammed(vehicle=self._sysid, at_s=at_s))
        north = simulated["SIM_GPS1_GLTCH_X"] * _METRES_PER_DEGREE
        east = simulated["SIM_GPS1_GLTCH_Y"] * self._east_m_per_deg
        if east != 0.0 or north != 0.0:
            direction, step = math.degrees(math.atan2(east, north)), math.hypot(east, north)
            active.append(GpsSpoofed(vehicle=self._sysid, at_s=at_s, direction_deg=direction, speed_mps=0.0, offset_m=step))
        return active
