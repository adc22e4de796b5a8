"""The registries of export formats. A format is one module and one line in `FORMATS` or `TABLES`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, cast

from gcs_coloc.core.errors import UsageError

if TYPE_CHECKING:
    from gcs_coloc.core.snapshot import FleetSnapshot
    from gcs_coloc.recorder.flight_history import FlightHistory
    from gcs_coloc.recorder.formats.vehicle_table import VehicleTable

FORMATS: dict[str, tuple[str, str]] = {
    "geojson": ("gcs_coloc.recorder.formats.geojson", "write_geojson"),
    "kml": ("gcs_coloc.recorder.formats.kml", "write_kml"),
}
"""Module and writer of what is drawn from a whole flight, by the suffix of its file. A writer takes the flight and the path."""
TABLES: dict[str, tuple[str, str]] = {
    "csv": ("gcs_coloc.recorder.formats.csv_table", "CsvTable"),
    "parquet": ("gcs_coloc.recorder.formats.parquet_table", "ParquetTable"),
}
"""Module and `VehicleTable` of what is written while the flight is replayed, by the suffix of its file."""


class FlightTables:
    """The tables of one flight, in files beside each other that are named after `base`.

    The files are opened with the first row. A flight without rows leaves empty tables.
    """

    def __init__(self, base: Path, suffixes: Sequence[str]) -> None:
        """Find the writers.

        Raises:
            UsageError: a format needs a package that is not installed.
        """
        self.files = [base.with_name(f"{base.name}.{suffix}") for suffix in suffixes]
        self._make = [_table_of(suffix) for suffix in suffixes]
        self._tables: list[VehicleTable] = []

    def add(self, fleet: FleetSnapshot) -> None:
        """Add a row for each vehicle.

        Raises:
            OSError: a file cannot be written.
        """
        for table in self._opened():
            table.add(fleet)

    def close(self) -> None:
        """Write what is left.

        Raises:
            OSError: a file cannot be written.
        """
        for table in self._opened():
            table.close()

    def _opened(self) -> list[VehicleTable]:
        if not self._tables:
            self._tables = [make(file) for make, file in zip(self._make, self.files, strict=True)]
        return self._tables


def _table_of(suffix: str) -> Callable[[Path], VehicleTable]:
    module, name = TABLES[suffix]
    try:
        return cast("Callable[[Path], VehicleTable]", getattr(import_module(module), name))
    except ModuleNotFoundError as error:
        raise UsageError(f"--{suffix}: needs {error.name}: pip install 'gcs-coloc[{suffix}]'") from None


def write_all(history: FlightHistory, base: Path) -> list[Path]:
    """Write a flight to one file for each of `FORMATS`, and return the files.

    They lie beside each other and are named after `base`.

    Raises:
        OSError: a file cannot be written.
    """
    files = []
    for suffix, (module, name) in FORMATS.items():
        writer = cast("Callable[[FlightHistory, Path], None]", getattr(import_module(module), name))
        files.append(base.with_name(f"{base.name}.{suffix}"))
        writer(history, files[-1])
    return files
