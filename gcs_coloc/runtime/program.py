"""The program that computes: two results can be compared, or mixed, where all of this is the same."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

import gcs_coloc

_COMPUTES = ("numpy", "scipy")
"""Packages whose version may change a result in its last bits."""


@cache
def program_digest() -> str:
    """Return a digest of the package's source: results of two states of the program are never mixed."""
    root = Path(gcs_coloc.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def program_versions() -> dict[str, str]:
    """Return what computes here, by name: gcs-coloc, its source's digest, Python, and the packages that do the arithmetic."""
    return {
        "gcs-coloc": gcs_coloc.__version__,
        "source": program_digest(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in _COMPUTES},
    }
