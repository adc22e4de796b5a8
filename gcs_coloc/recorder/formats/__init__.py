"""Export formats. A format is one module with a writer, and one line in `write_all`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gcs_coloc.recorder.flight_history import FlightHistory


def write_all(history: FlightHistory, base: Path) -> list[Path]:
    """Write what is drawn from a whole flight, a file for each format, and return the files.

    They lie beside each other and are named after `base`.

    Raises:
        OSError: a file cannot be written.
    """
    # Here, as the recorder needs another module of this package and none of what these bring.
    from gcs_coloc.recorder.formats.maps import write_geojson, write_kml

    files = []
    for suffix, write in (("geojson", write_geojson), ("kml", write_kml)):
        files.append(base.with_name(f"{base.name}.{suffix}"))
        write(history, files[-1])
    return files
