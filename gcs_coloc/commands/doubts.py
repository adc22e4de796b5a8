"""What a recording says against itself, on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from gcs_coloc.plausibility.doubt import Doubt


def warn_of_doubts(path: Path, doubts: Iterable[Doubt]) -> None:
    """Say what does not agree, one line each."""
    for doubt in doubts:
        print(f"gcs-coloc: warning: {path}: {doubt.text}", file=sys.stderr)
