"""The table of vehicles as CSV; an empty cell where a value is unknown."""

from __future__ import annotations

import csv
from pathlib import Path

from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.recorder.formats.vehicle_table import COLUMNS, Column


class CsvTable:
    """Writes the table of vehicles to a CSV file, row by row."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._writer.writerow(["unix_s", *(column.name for column in COLUMNS)])

    def add(self, fleet: FleetSnapshot) -> None:
        """As `VehicleTable`."""
        at = f"{fleet.at_s:.6f}"
        self._writer.writerows([at, *(_text(column, v) for column in COLUMNS)] for v in fleet.vehicles)

    def close(self) -> None:
        """As `VehicleTable`."""
        self._file.close()


def _text(column: Column, v: VehicleSnapshot) -> str:
    value = column.value(v)
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.{column.digits}f}"
    return str(int(value)) if isinstance(value, bool) else str(value)
