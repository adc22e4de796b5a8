"""The autopilot parameters that matter to aiding and its trials.

Names and meanings are ArduPilot's or PX4's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Literal

Kind = Literal["ardupilot", "px4"]

REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""

INT32 = 6
"""MAV_PARAM_TYPE_INT32."""

_ARDUPILOT: dict[str, float] = {
    "EK3_CHECK_SCALE": 150.0,
    "EK3_GPS_CHECK": 31.0,
    "EK3_SRC1_VELZ": 3.0,
    "GPS1_DELAY_MS": 0.0,
    "GPS1_TYPE": 1.0,
    "GPS2_DELAY_MS": 0.0,
    "GPS2_TYPE": 14.0,
    "GPS_AUTO_SWITCH": 4.0,
    "GPS_PRIMARY": 0.0,
    "MAV1_EXTRA1": 10.0,
    "MAV1_EXTRA2": 10.0,
    "MAV1_EXTRA3": 10.0,
    "MAV1_EXT_STAT": 10.0,
    "MAV1_POSITION": 10.0,
    "MAV2_OPTIONS": 8.0,
    "MAV_GCS_SYSID": 255.0,
    "MAV_OPTIONS": 0.0,
    "SERIAL0_BAUD": 115.0,
    "SERIAL0_PROTOCOL": 2.0,
    "SIM_GPS1_ENABLE": 1.0,
    "SIM_GPS1_GLTCH_X": 0.0,
    "SIM_GPS1_GLTCH_Y": 0.0,
    "SIM_GPS1_JAM": 0.0,
    "SYSID_THISMAV": 1.0,
}
_PX4: dict[str, float] = {
    "EKF2_AGP0_CTRL": 1.0,
    "EKF2_AGP0_DELAY": 0.0,
    "EKF2_AGP0_GATE": 3.0,
    "EKF2_AGP0_ID": 1.0,
    "EKF2_AGP0_NOISE": 1.0,
    "EKF2_EVP_GATE": 5.0,
    "EKF2_EVP_NOISE": 0.1,
    "EKF2_EV_CTRL": 0.0,
    "EKF2_EV_DELAY": 0.0,
    "EKF2_EV_NOISE_MD": 0.0,
    "EKF2_RNGBC_CTRL": 0.0,
    "EKF2_RNGBC_DELAY": 0.0,
    "EKF2_RNGBC_GATE": 5.0,
    "EKF2_RNGBC_NOISE": 30.0,
    "EKF2_REQ_EPH": 3.0,
    "EKF2_REQ_EPV": 5.0,
    "EKF2_REQ_NSATS": 6.0,
    "EKF2_REQ_SACC": 0.5,
    "EKF2_SENS_EN": 8191.0,
    "MAV_SYS_ID": 1.0,
}
DEFAULTS: Mapping[Kind, Mapping[str, float]] = {"ardupilot": _ARDUPILOT, "px4": _PX4}
"""Names and defaults: a vehicle set up for GPS_INPUT on its second receiver; one set up for auxiliary global positions."""

_REAL = {
    *("SIM_GPS1_GLTCH_X", "SIM_GPS1_GLTCH_Y"),
    *("EKF2_EVP_GATE", "EKF2_EVP_NOISE", "EKF2_EV_DELAY"),
    *("EKF2_RNGBC_DELAY", "EKF2_RNGBC_GATE", "EKF2_RNGBC_NOISE"),
    *("EKF2_AGP0_DELAY", "EKF2_AGP0_GATE", "EKF2_AGP0_NOISE", "EKF2_REQ_EPH", "EKF2_REQ_EPV", "EKF2_REQ_SACC"),
}
_SYSTEM_ID: Mapping[Kind, str] = {"ardupilot": "SYSID_THISMAV", "px4": "MAV_SYS_ID"}


class Parameters(Mapping[str, float]):
    """One vehicle's parameters. They survive a reboot."""

    def __init__(self, sysid: int, overrides: Mapping[str, float], kind: Kind = "ardupilot") -> None:
        self._kind: Kind = kind
        self._values = {**DEFAULTS[kind], **overrides, _SYSTEM_ID[kind]: float(sysid)}

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def set(self, name: str, value: float) -> None:
        """Set a parameter; integers are rounded.

        The vehicle's own system id stays as it is (it is the scenario's).
        """
        if name not in _SYSTEM_ID.values():
            self._values[name] = value if name in _REAL else float(round(value))

    def type_of(self, name: str) -> int:
        """MAV_PARAM_TYPE of a parameter."""
        return REAL32 if name in _REAL else INT32

    def on_the_wire(self, name: str) -> float:
        """Return the value as PARAM_VALUE carries it.

        PX4 puts an integer's bytes into the float field, ArduPilot its number.
        """
        if self._kind == "px4" and name not in _REAL:
            return float(struct.unpack("<f", struct.pack("<i", int(self[name])))[0])
        return self[name]

    def from_the_wire(self, name: str, field: float) -> float:
        """A value as PARAM_SET carries it, turned into its number."""
        if self._kind == "px4" and name not in _REAL:
            return float(struct.unpack("<i", struct.pack("<f", field))[0])
        return field
