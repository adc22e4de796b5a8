"""The table of vehicles as Parquet, for pandas, Polars, DuckDB and Spark.

The columns are typed, and a cell is null where a value is unknown.

Needs pyarrow, the extra `parquet`.
"""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
from pyarrow.parquet import ParquetWriter

from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.recorder.formats.vehicle_table import COLUMNS, Cell

_ROWS_AT_ONCE = 20_000
"""Rows of a row group. Chosen: some megabytes of memory, and groups large enough to compress well."""
_TYPES = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
_SCHEMA = pa.schema([("unix_s", pa.float64()), *((column.name, _TYPES[column.kind]) for column in COLUMNS)])


class ParquetTable:
    """Writes the table of vehicles to a Parquet file, a row group at a time."""

    def __init__(self, path: Path) -> None:
        self._writer = ParquetWriter(path, _SCHEMA)
        self._columns: list[list[Cell]] = [[] for _ in _SCHEMA]

    def add(self, fleet: FleetSnapshot) -> None:
        """As `VehicleTable`."""
        times, *others = self._columns
        times.extend([fleet.at_s] * len(fleet.vehicles))
        for cells, column in zip(others, COLUMNS, strict=True):
            cells.extend(map(column.value, fleet.vehicles))
        if len(times) >= _ROWS_AT_ONCE:
            self._write()

    def close(self) -> None:
        """As `VehicleTable`."""
        self._write()
        self._writer.close()

    def _write(self) -> None:
        self._writer.write_table(pa.table(self._columns, schema=_SCHEMA))
        for cells in self._columns:
            cells.clear()
