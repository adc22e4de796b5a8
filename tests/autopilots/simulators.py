"""Processes of real autopilots' simulators: ArduPilot's SITL and PX4's SIH, one process a vehicle, on loopback.

Nothing of either project is here: the paths of their programs are given (see docs/how-to/fly-real-autopilots.md).
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ORIGIN_LAT_DEG, ORIGIN_LON_DEG, ORIGIN_ALT_M = 47.5, 9.0, 450.0
"""Any place; away from 0 degrees, where errors of sign hide."""

COMPANION = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: who reports ranges."""

# What the guide asks for, and what a driver needs: any mission may be flown without a pilot's transmitter.
# EK3_SRC1_VELZ is not set to 0: at its default of 3 the altitude swings if what is sent has a vertical velocity.
GUIDE: Mapping[str, float] = {
    "GPS1_TYPE": 1,
    "GPS2_TYPE": 14,
    "GPS_PRIMARY": 0,
    "GPS_AUTO_SWITCH": 4,
    "GPS2_DELAY_MS": 100,
    "MAV2_OPTIONS": 8,  # forward messages that it does not know (PEER_RANGE) from this port
    "SIM_GPS1_ENABLE": 1,
    "SIM_GPS2_ENABLE": 0,
    "SIM_WIND_SPD": 6,
    "SIM_WIND_DIR": 250,
    "SIM_WIND_TURB": 1,
    "TERRAIN_ENABLE": 0,
}
PLANE: Mapping[str, float] = {**GUIDE, "ARSPD_USE": 1, "THR_FAILSAFE": 0, "FS_LONG_ACTN": 0, "FS_SHORT_ACTN": 3}
_CALIBRATED: Mapping[str, float] = {
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
    **{
        f"COMPASS_OFS{n}_{axis}": offset
        for n in ("", "2", "3")
        for axis, offset in (("X", 5), ("Y", 13), ("Z", -18))
    },
}  # fmt: skip
"""Calibrations that are there, or it does not arm."""
COPTER: Mapping[str, float] = {
    **GUIDE,
    **_CALIBRATED,
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 0,
    "AUTO_OPTIONS": 3,  # arms and takes off in AUTO without a raised throttle stick
    "FS_THR_ENABLE": 0,
    "FS_GCS_ENABLE": 0,
    "MOT_THST_HOVER": 0.39,
    "MOT_BAT_VOLT_MIN": 9.6,
    "MOT_BAT_VOLT_MAX": 12.8,
    "WP_YAW_BEHAVIOR": 1,
}
QUADPLANE: Mapping[str, float] = {
    **PLANE,
    "Q_ENABLE": 1,
    "Q_ASSIST_SPEED": 18,
    "Q_M_PWM_MIN": 1000,
    "Q_M_PWM_MAX": 2000,
    "Q_M_BAT_VOLT_MIN": 9.6,
    "Q_M_BAT_VOLT_MAX": 12.8,
    "SCHED_LOOP_RATE": 300,
}
ROVER: Mapping[str, float] = {
    **GUIDE,
    **_CALIBRATED,
    "FS_ACTION": 0,
    "FS_THR_ENABLE": 0,
    "FS_GCS_ENABLE": 0,
    "ATC_STR_RAT_FF": 0.75,
    "CRUISE_SPEED": 5,
    "CRUISE_THROTTLE": 30,
    "WP_SPEED": 5,
    "WP_RADIUS": 3,
}


@dataclass(frozen=True)
class Place:
    """Where one vehicle starts: degrees, metres above mean sea level."""

    lat_deg: float
    lon_deg: float
    alt_m: float = ORIGIN_ALT_M


class Simulator:
    """One simulated vehicle's process. `log` has what it prints."""

    def __init__(self, command: list[str], directory: Path, environment: Mapping[str, str] | None = None) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self.log = directory / "simulator.log"
        with self.log.open("wb") as log:
            self._process = subprocess.Popen(
                command,
                cwd=directory,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=None if environment is None else {**os.environ, **environment},
            )

    @property
    def running(self) -> bool:
        """Whether the process lives."""
        return self._process.poll() is None

    def stop(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait()


def ardupilot(
    program: Path, model: str, sysid: int, place: Place, service_port: int, driver_port: int, directory: Path,
    parameters: Mapping[str, float],
) -> Simulator:  # fmt: skip
    """Start ArduPilot's SITL: its first port to the service, its second to the driver (who is companion and ground station)."""
    directory.mkdir(parents=True, exist_ok=True)
    defaults = directory / "flight.parm"
    defaults.write_text("".join(f"{name} {value:g}\n" for name, value in parameters.items()), encoding="utf-8")
    home = f"{place.lat_deg:.7f},{place.lon_deg:.7f},{place.alt_m:g},0"
    options = ["--model", model, "--instance", str(sysid), "--sysid", str(sysid), "--speedup", "1", "--home", home, "--wipe"]
    ports = [f"--serial0=udpclient:127.0.0.1:{service_port}", f"--serial1=udpclient:127.0.0.1:{driver_port}"]
    in_the_program = ["@ROMFS/models/plane.parm"] if "plane" in model else []
    files = [*in_the_program, str(defaults)]
    return Simulator([str(program), *options, "--defaults", ",".join(files), *ports], directory)


def px4(program: Path, model: str, sysid: int, place: Place, directory: Path, parameters: Mapping[str, float]) -> Simulator:
    """Start PX4's SITL with SIH. `program` is build/px4_sitl_sih/bin/px4; its ports follow from the instance, sysid - 1."""
    environment = {
        "PX4_SIM_MODEL": model,
        "PX4_SIMULATOR": "sihsim",
        "PX4_HOME_LAT": f"{place.lat_deg:.7f}",
        "PX4_HOME_LON": f"{place.lon_deg:.7f}",
        "PX4_HOME_ALT": f"{place.alt_m:g}",
        "HOME": str(directory),
        **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in parameters.items()},
    }
    return Simulator([str(program), "-i", str(sysid - 1), "-d", str(program.parent.parent / "etc")], directory, environment)
