"""Faults asked for at run time: what the parameters of COMMAND_LONG MAV_CMD_USER_1 (31010) mean."""

from __future__ import annotations

from typing import Any

from sitl_fakes.faults import (
    ClockJump,
    Fault,
    GpsFrozen,
    GpsJammed,
    GpsLost,
    GpsSpoofed,
    LinkDropout,
    RangeBias,
    RangeDropout,
    RangeStuck,
    Reboot,
)


def fault_of_command(sysid: int, params: list[float], at_s: float) -> Fault | None:
    """Read the fault that MAV_CMD_USER_1 asks for, None where it asks for none that exists.

    `params[0]`: 1 GPS lost, 2 jammed, 3 frozen, 4 spoofed (params[1] direction in deg, [2] m/s, [3] step in m), 5 ranges
    dropped, 6 biased by params[2] m, 7 stuck (params[1] the peer, 0 all), 8 link dead, 9 reboot, 10 clock jump by params[2] s.
    `params[6]`: how long, s; 0 for good (refused for a dead link, which no command could mend). Raises ValueError or
    OverflowError where a number is not finite, or none that such a fault can have.
    """
    kind, second, third, fourth = params[0], params[1], params[2], params[3]
    lasts = params[6] if params[6] != 0.0 else None
    times: dict[str, Any] = {"vehicle": sysid, "at_s": at_s, "until_s": None if lasts is None else at_s + lasts}
    if kind in (5.0, 6.0, 7.0):
        times["peer"] = int(second) or None
    if kind == 1.0:
        return GpsLost(**times)
    if kind == 2.0:
        return GpsJammed(**times)
    if kind == 3.0:
        return GpsFrozen(**times)
    if kind == 4.0:
        return GpsSpoofed(**times, direction_deg=second, speed_mps=third, offset_m=fourth)
    if kind == 5.0:
        return RangeDropout(**times)
    if kind == 6.0:
        return RangeBias(**times, bias_m=third)
    if kind == 7.0:
        return RangeStuck(**times)
    if kind == 8.0 and lasts is not None:
        return LinkDropout(**times)
    if kind == 9.0:
        return Reboot(vehicle=sysid, at_s=at_s)
    if kind == 10.0:
        return ClockJump(vehicle=sysid, at_s=at_s, by_s=third)
    return None
