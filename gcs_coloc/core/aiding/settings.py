"""The settings of aiding: `[aiding]` of the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from gcs_coloc.core.setting_bounds import between, check_bounds, positive
from gcs_coloc.core.stations.node_id import LARGEST_READ_SYSTEM_ID

AidingMethodName = Literal[
    "auto", "gps_input", "external_position", "global_position_sensor", "vision_position", "ranging_beacon"
]


@dataclass(frozen=True, slots=True)
class AidingSettings:
    """What is sent to a GNSS-denied vehicle."""

    method: AidingMethodName = "auto"
    """The message: `gps_input`, `external_position` (MAV_CMD_EXTERNAL_POSITION_ESTIMATE), `global_position_sensor`,
    `vision_position` or `ranging_beacon` (ranges, which PX4 fuses itself; never chosen by `auto`).
    `auto` goes by PX4's parameters (`EKF2_AGP0_CTRL`, else `EKF2_EV_CTRL`), and takes GPS_INPUT for ArduPilot, with external
    estimates beside it while its EKF has no absolute position and would not align on one so coarse. Other autopilots get nothing
    but an alarm, as their methods are unknown."""
    methods: Mapping[int, AidingMethodName] = field(default_factory=dict)
    """The method of single vehicles by system id, as `4 = "external_position"`."""
    rate_hz: float = between(10.0, 1.0, 50.0)
    """GPS_INPUT messages per second. ArduPilot calls a receiver unhealthy below 4.7 Hz (AP_GPS); beyond 50 Hz a radio floods."""
    external_rate_hz: float = between(1.0, 0.1, 10.0)
    """External position estimates per second. Chosen: each resets the EKF's position, so few are better than many."""
    lag_s: float = between(0.1, 0.0, 1.0)
    """Age that the vehicle takes GPS_INPUT to have where its GPS2_DELAY_MS is 0 or not known; else the parameter counts.
    Source: 0.1 s is what EKF3 used of the driver's 0.2 s in flight, as its buffer is sized at boot for other sensors."""
    gps_id: int = between(1, 0, 1)
    """Zero-based receiver instance that is set to MAVLink on the vehicle (GPS_INPUT.gps_id): 0 is GPS1, 1 is GPS2."""
    alert_limit_m: float = positive(50.0)
    """No fix is sent while the horizontal protection level exceeds this. Chosen: what the operator's airspace allows."""
    require_fault_tests: bool = False
    """`true`: no fix is sent while the ranges cannot test the receiver of every peer, as with one or two peers, and the ranging
    device, as with all peers to one side. `false`: it is sent, and the page names what must be right."""
    regain_after_s: float = between(3.0, 0.0)
    """A lost fix comes back only after it has been sound for this long; after at most a second where it was only too uncertain.
    Chosen: against a fix that flickers."""
    prediction_s: float = positive(10.0)
    """No fix is sent without a range in use for longer than this, however small the bound. The same holds where ranges to
    one peer, or along one line (HDOP above 30), do not fix the position and no airspeed and bank angle tell the motion."""
    hand_back_s: float = between(3.0, 0.0)
    """The stream goes on for this long after the vehicle's own GPS is healthy again, then ends with fix_type 1."""
    standby: bool = False
    """Healthy vehicles get their own estimate, so that they arm with GPS2_TYPE=14 and fail over without a gap.
    Only vehicles with GPS_AUTO_SWITCH 4 or 0 and a GPS_PRIMARY other than ours."""
    switch_primary: Literal["off", "auto"] = "off"
    """`auto`: GPS_PRIMARY of an aided vehicle is set to our receiver as soon as its own one has failed: a jammed one has false
    fixes within seconds. It is restored when the GPS is healthy, or aiding or the service ends.
    `off`: only on the operator's command. A PX4 is told to leave its own GPS out of EKF2 instead, where its firmware can,
    and where that GPS reports a fix though it has failed, or its fix flickers."""
    stand_down_s: float = positive(10.0)
    """Where another sender feeds the same receiver with GPS_INPUT, ours stops until that one was silent for this long."""
    ek3_gps_check: int = between(31, 0)
    """The vehicle's parameter EK3_GPS_CHECK (bit mask), until the vehicle has reported it. Source: ArduPilot's default."""
    ek3_check_scale: float = positive(150.0)
    """The vehicle's parameter EK3_CHECK_SCALE, percent, until the vehicle has reported it. ArduPilot's default for
    planes; it is 100 for copters, rovers and submarines."""

    def method_of(self, sysid: int) -> AidingMethodName:
        """Return the method that is set for a vehicle."""
        return self.methods.get(sysid, self.method)

    def hands_over_ranges(self, sysid: int) -> bool:
        """Return whether a vehicle is handed ranges."""
        return self.method_of(sysid) == "ranging_beacon"

    def __post_init__(self) -> None:
        check_bounds(self)
        for sysid in self.methods:
            if not 1 <= sysid <= LARGEST_READ_SYSTEM_ID:
                raise ValueError(f"methods: {sysid} is not a MAVLink system id (1 to {LARGEST_READ_SYSTEM_ID})")
