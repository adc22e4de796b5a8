"""What a recording says against itself, on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from gcs_coloc.evaluation.data_checks.finding import DataFinding


def warn_of_findings(path: Path, doubts: Iterable[DataFinding]) -> None:
    """Say what does not agree, one line each."""
    for doubt in doubts:
        print(f"gcs-coloc: warning: {path}: {doubt.text}", file=sys.stderr)
