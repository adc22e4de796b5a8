"""Recordings, one or all below directories, with their tables and a digest of their content."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gcs_coloc.core.errors import DataError, UsageError


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """One recording, with the tables beside it.

    Of one that was searched for, `name` is the name of the directory and the path below it, so that it is the same wherever that
    directory lies, and `file`, `ranges` and `truth` are absolute. `digest` is of the bytes of all three.
    """

    name: str
    file: Path
    ranges: Path | None
    truth: Path | None
    digest: str


def find_recordings(directories: Sequence[Path]) -> list[FoundRecording]:
    """Return every recording (`*.tlog`) below the directories, by name.

    Raises:
        DataError: there is none below one of the directories, or a file cannot be read.
        UsageError: a directory is none, or two recordings would have the same name.
    """
    found: dict[str, FoundRecording] = {}
    for directory in directories:
        if not directory.is_dir():
            raise UsageError(f"{directory}: is no directory; state directories with recordings (*.tlog) below them")
        root = directory.resolve()
        files = sorted(root.rglob("*.tlog"))
        if not files:
            raise DataError(f"{directory}: there is no recording (*.tlog) below it")
        for file in files:
            name = (Path(root.name) / file.relative_to(root)).as_posix()
            if name in found and found[name].file != file:
                raise UsageError(f"{file} and {found[name].file} would both be {name}; judge their directories one by one")
            found[name] = find_recording(file, name)
    return [found[name] for name in sorted(found)]


def find_recording(file: Path, name: str) -> FoundRecording:
    """Return a recording with its tables.

    Those of `NAME.tlog` are `NAME.ranges.csv` and `NAME.truth.csv` beside it, or `ranges.csv` and `truth.csv` where it is the
    only recording of its directory.

    Raises:
        DataError: a file cannot be read.
    """
    is_alone = all(other == file for other in file.parent.glob("*.tlog"))
    ranges, truth = (_table(file, what, is_alone=is_alone) for what in ("ranges", "truth"))
    digest = hashlib.sha256()
    for path in (file, ranges, truth):
        digest.update(_digest(path) if path is not None else b"-")
    return FoundRecording(name, file, ranges, truth, digest.hexdigest()[:16])


def _digest(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def _table(file: Path, what: str, *, is_alone: bool) -> Path | None:
    own, common = file.with_suffix(f".{what}.csv"), file.with_name(f"{what}.csv")
    return own if own.exists() else common if is_alone and common.exists() else None
