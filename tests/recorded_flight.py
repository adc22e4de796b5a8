"""A recorded flight of the simulated aircraft; vehicle 4 loses its GPS."""

from __future__ import annotations

import csv
import struct
from collections.abc import Iterable
from pathlib import Path

from gcs_coloc.recorder.side_tables import TruthPoint
from sitl_fakes.faults import GpsLost
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import Scenario, load_scenario

LOST_S = 10.0
EPOCH_S = 1_780_000_000.0


def early_loss(name: str = "uwb", lost_s: float = LOST_S) -> Scenario:
    """A scenario in which vehicle 4 loses its GPS and nothing else goes wrong."""
    return load_scenario(name).model_copy(update={"fault": [GpsLost(vehicle=4, at_s=lost_s)]})


def write_flight(path: Path, seconds: float, scenario: Scenario | None = None) -> list[TruthPoint]:
    """Write the tlog of a scenario, None: the early loss; returns where each vehicle truly was every 0.2 s."""
    fleet, truth = Fleet(scenario or early_loss(), seed=3, unix_epoch_s=EPOCH_S), []
    with path.open("wb") as file:
        for step in range(1, round(seconds * 50) + 1):
            for datagram in fleet.advance(step * 0.02):
                file.write(struct.pack(">Q", round((EPOCH_S + datagram.due_s) * 1e6)) + datagram.payload)
            if step % 10 == 0:
                points = fleet.truth().items()
                truth += [TruthPoint(EPOCH_S + t.at_s, v, t.lat_deg, t.lon_deg, t.alt_msl_m) for v, t in points]
    return truth


def write_truth(path: Path, truth: Iterable[TruthPoint]) -> None:
    """Write a truth.csv."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("unix_s", "sysid", "lat_deg", "lon_deg", "alt_msl_m"))
        writer.writerows((p.unix_s, p.sysid, p.lat_deg, p.lon_deg, p.alt_msl_m) for p in truth)
