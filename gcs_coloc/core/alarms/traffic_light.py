"""The traffic light of a vehicle: its most serious condition as a colour, and the reason in words."""

from __future__ import annotations

from typing import Literal

from gcs_coloc.core.alarms.alarms import conditions
from gcs_coloc.core.snapshot import VehicleSnapshot

LightColour = Literal["good", "caution", "bad", "unknown"]


def traffic_light(v: VehicleSnapshot) -> tuple[LightColour, str]:
    """The colour for one vehicle and the reason in words: its most serious condition, from which its alarm is as well."""
    found = conditions(v)
    if found:
        return ("bad" if found[0].level == "error" else "caution"), found[0].text
    return ("unknown", v.gps_reason) if v.gps_state == "unknown" else ("good", f"GPS healthy: {v.gps_reason}")
