"""Regenerates the Python of our MAVLink messages: `python -m tools.regenerate_dialect`, after a change of gcs_coloc.xml."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

from pymavlink.generator import mavgen, mavparse

_PACKAGE = Path(__file__).parents[1] / "gcs_coloc/mavlink"
DIALECT_XML = _PACKAGE / "gcs_coloc.xml"
GENERATED_MODULE = _PACKAGE / "_generated" / "gcs_coloc.py"


def generate(output: Path) -> None:
    """Write the Python module of `gcs_coloc.xml` to `output` with pymavlink's generator, the XML checked by its schema.

    Raises RuntimeError with the generator's own words where it refuses the XML.
    """
    options = mavgen.Opts(str(output), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3", validate=True, strict_units=True)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        done = mavgen.mavgen(options, [str(DIALECT_XML)])
    if not done:
        raise RuntimeError(f"{DIALECT_XML.name} could not be generated: {said.getvalue()}")


if __name__ == "__main__":
    generate(GENERATED_MODULE)
    sys.stdout.write(f"{GENERATED_MODULE}\n")
