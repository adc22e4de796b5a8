"""A recorded flight of the simulated aircraft: vehicle 4 loses its GPS after 20 s."""

from __future__ import annotations

import struct
from pathlib import Path

from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import SCENARIOS, load_scenario

SCENARIO = SCENARIOS / "uwb.toml"
EPOCH_S = 1_780_000_000.0


def write_flight(path: Path, seconds: float, scenario: Path = SCENARIO) -> dict[float, tuple[float, float]]:
    """Write the tlog of a scenario; returns where vehicle 4 truly was: latitude and longitude by UNIX seconds, every 0.2 s."""
    fleet = Fleet(load_scenario(scenario), seed=3, unix_epoch_s=EPOCH_S)
    truth = {}
    with path.open("wb") as file:
        for step in range(1, round(seconds * 50) + 1):
            for datagram in fleet.advance(step * 0.02):
                file.write(struct.pack(">Q", round((EPOCH_S + datagram.due_s) * 1e6)) + datagram.payload)
            if step % 10 == 0:
                t = fleet.truth()[4]
                truth[EPOCH_S + t.at_s] = (t.lat_deg, t.lon_deg)
    return truth
