"""The settings of aid: `[aiding]` of the configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

AidingMethodName = Literal["auto", "gps_input", "external_position", "global_position_sensor"]


@dataclass(frozen=True, slots=True)
class AidingSettings:
    """How vehicles are aided.

    `method`: by which message; "auto" goes by the autopilot. `methods`: the same for single vehicles, by system id.
    `rate_hz`: GPS_INPUT rate; ArduPilot calls a receiver unhealthy below 4.7 Hz. `external_rate_hz`: that of external estimates.
    `lag_s`: age that the vehicle's driver takes GPS_INPUT to have (its GPS_DELAY).
    `gps_id`: zero-based receiver instance that the vehicle has set to MAVLink (1 is GPS2).
    `alert_limit_m`: no fix is claimed while the 95 % horizontal bound is beyond this.
    `regain_after_s`: a fix that was lost comes back only after the bound has been within the limit for so long.
    `prediction_s`: no fix is claimed where no range has been in use, or none that fix the place, for longer than this.
    `hand_back_s`: the stream goes on for so long after the vehicle's own GPS is healthy again.
    `standby`: healthy vehicles are streamed their own estimate.
    `switch_primary`: "auto" sets GPS_PRIMARY to our receiver on an aided vehicle whose own one lies; "off" only on command.
    `stand_down_s`: how long nobody else's GPS_INPUT must have been heard before ours begins again.
    `ek3_gps_check`, `ek3_check_scale`: the vehicle's parameters of these names, until it has told them itself.
    """

    method: AidingMethodName = "auto"
    methods: Mapping[int, AidingMethodName] = field(default_factory=dict)
    rate_hz: float = 10.0
    external_rate_hz: float = 1.0
    lag_s: float = 0.2
    gps_id: int = 1
    alert_limit_m: float = 50.0
    regain_after_s: float = 3.0
    prediction_s: float = 10.0
    hand_back_s: float = 3.0
    standby: bool = False
    switch_primary: Literal["off", "auto"] = "off"
    stand_down_s: float = 10.0
    ek3_gps_check: int = 31
    ek3_check_scale: float = 150.0
