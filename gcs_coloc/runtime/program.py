"""The program that computes: two results can be compared, or mixed, where all of this is the same."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

_COMPUTES = ("numpy", "scipy")
"""Packages whose version may change a result in its last bits."""


_PACKAGES = ("gcs_coloc", "sitl_fakes")
"""What is installed together. Studies fly the simulated aircraft; named here, as only the study may import them."""
_SOURCES = (".py", ".so", ".toml")
"""Endings of files that a result may depend on; scenarios are TOML."""


@cache
def program_digest() -> str:
    """Return a digest of the source, simulated aircraft included.

    Results of two states of the program are never mixed.
    """
    digest = hashlib.sha256()
    for name in _PACKAGES:
        for part in source_of(name):
            digest.update(part)
    return digest.hexdigest()[:16]


def source_of(package: str) -> Iterator[bytes]:
    """Yield what a digest of a top-level package or module consists of; imports nothing.

    Of one that is not there it is the name.
    """
    yield package.encode()
    spec = find_spec(package)
    if spec is None:
        return
    roots = [Path(root) for root in spec.submodule_search_locations or ()]
    for root in roots:
        for path in sorted(path for path in root.rglob("*") if path.suffix in _SOURCES and path.is_file()):
            yield path.relative_to(root).as_posix().encode() + path.read_bytes()
    if not roots and spec.origin is not None and Path(spec.origin).is_file():
        yield Path(spec.origin).read_bytes()


@cache
def program_versions() -> dict[str, str]:
    """Return the versions of what computes here, by name.

    These are gcs-coloc, its source's digest, Python, and the packages that do the arithmetic.
    """
    return {
        "gcs-coloc": version("gcs-coloc"),
        "source": program_digest(),
        "Python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in _COMPUTES},
    }
