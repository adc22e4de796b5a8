"""The keys of configurations written for 0.1, and what each is called now: an error names the new key."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

RENAMED: Mapping[str, str] = MappingProxyType(
    {
        "aid": "aiding",
        "aid.way": "aiding.method",
        "aid.ways": "aiding.methods",
        "feed": "measurements",
        "feed.least_position_sigma_m": "measurements.min_position_sigma_m",
        "feed.oldest_s": "measurements.max_age_s",
        "fleet.most_vehicles": "fleet.max_vehicles",
        "health": "gps_health",
        "senders.roam_after_s": "senders.rebind_after_s",
        "time.least_delay_s": "time.min_delay_s",
        "time.least_delay_sigma_s": "time.min_delay_sigma_s",
    }
)
"""Key of 0.1 to key of 0.2; a section stands before its keys."""


def new_name(key: str) -> str | None:
    """The name since 0.2 of a key that 0.2 refuses, also where its section is renamed already; None where 0.1 had no such key."""
    return RENAMED.get(key) or _HALF_RENAMED.get(key)


def _with_new_section(key: str) -> str:
    section, _, rest = key.partition(".")
    return f"{RENAMED.get(section, section)}.{rest}"


_HALF_RENAMED = {_with_new_section(old): new for old, new in RENAMED.items() if "." in old}
