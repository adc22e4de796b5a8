"""The autopilot parameters that matter to GPS aiding and its trials, with ArduPilot's names and meanings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

REAL32 = 9
"""MAV_PARAM_TYPE_REAL32. ArduPilot sends every value as a float, whatever its type."""

INT32 = 6
"""MAV_PARAM_TYPE_INT32."""

DEFAULTS: dict[str, float] = {
    "EK3_CHECK_SCALE": 150.0,
    "EK3_GPS_CHECK": 31.0,
    "GPS1_TYPE": 1.0,
    "GPS2_TYPE": 14.0,
    "GPS_AUTO_SWITCH": 4.0,
    "GPS_PRIMARY": 0.0,
    "MAV_GCS_SYSID": 255.0,
    "MAV_OPTIONS": 0.0,
    "SIM_GPS1_ENABLE": 1.0,
    "SIM_GPS1_GLTCH_X": 0.0,
    "SIM_GPS1_GLTCH_Y": 0.0,
    "SIM_GPS1_JAM": 0.0,
    "SYSID_THISMAV": 1.0,
}
"""Names and defaults: a vehicle set up for GPS_INPUT on its second receiver."""

_REAL = {"SIM_GPS1_GLTCH_X", "SIM_GPS1_GLTCH_Y"}
_READ_ONLY = {"SYSID_THISMAV"}


class Parameters(Mapping[str, float]):
    """One vehicle's parameters. They survive a reboot."""

    def __init__(self, sysid: int, overrides: Mapping[str, float]) -> None:
        self._values = {**DEFAULTS, **overrides, "SYSID_THISMAV": float(sysid)}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def set(self, name: str, value: float) -> None:
        """Set a parameter; integers are rounded. The vehicle's own system id stays as it is (it is the scenario's)."""
        if name not in _READ_ONLY:
            self._values[name] = value if name in _REAL else float(round(value))

    def type_of(self, name: str) -> int:
        """MAV_PARAM_TYPE of a parameter."""
        return REAL32 if name in _REAL else INT32
