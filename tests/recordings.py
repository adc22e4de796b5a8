"""Recordings too large for the repository, looked for beside the checkout."""

from __future__ import annotations

from pathlib import Path

import pytest

from gcs_coloc.recorder.tlog import TlogReader, tlog_record

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "data"


def recording(name: str) -> Path:
    """The path of a recording; skips the calling test where there is none."""
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"the recording {name} is not beside this checkout")
    return path


def part(log: Path, directory: Path, from_unix_s: float, to_unix_s: float = float("inf")) -> Path:
    """A new recording of what is between two times in one."""
    path = directory / "part.tlog"
    with path.open("wb") as file:
        for record in TlogReader(log):
            if from_unix_s <= record.unix_s <= to_unix_s:
                file.write(tlog_record(record.unix_s, record.frame))
    return path
