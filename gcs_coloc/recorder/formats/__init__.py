"""The registry of export formats. An export format is one module and one line in `FORMATS`."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from gcs_coloc.recorder.flight_history import FlightHistory

FORMATS: dict[str, tuple[str, str]] = {
    "csv": ("gcs_coloc.recorder.formats.csv_table", "write_csv"),
    "geojson": ("gcs_coloc.recorder.formats.geojson", "write_geojson"),
    "kml": ("gcs_coloc.recorder.formats.kml", "write_kml"),
}
"""Module and writer of each format, by the suffix of its file. A writer takes the flight and the file's path."""


def write_all(history: FlightHistory, base: Path) -> list[Path]:
    """Write a flight in every format, to files beside each other named after `base`; returns the files.

    Raises:
        OSError: a file cannot be written.
    """
    files = []
    for suffix, (module, name) in FORMATS.items():
        writer = cast("Callable[[FlightHistory, Path], None]", getattr(import_module(module), name))
        files.append(base.with_name(f"{base.name}.{suffix}"))
        writer(history, files[-1])
    return files
