"""Recordings too large for the repository, looked for beside the checkout."""

from __future__ import annotations

from pathlib import Path

import pytest

RECORDINGS = Path(__file__).resolve().parents[2] / "shared" / "data"


def recording(name: str) -> Path:
    """The path of a recording; skips the calling test where there is none."""
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"the recording {name} is not beside this checkout")
    return path
