"""What a recording says against itself, on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from gcs_coloc.evaluation.data_checks.findings import DataFinding


def warn_of_findings(path: Path, findings: Iterable[DataFinding]) -> None:
    """Say what does not agree, one line each."""
    for finding in findings:
        print(f"gcs-coloc: warning: {path}: {finding.text}", file=sys.stderr)
