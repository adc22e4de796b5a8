"""Log segments: a tlog and an MCAP file side by side, which can be opened after a crash.

The oldest are deleted to make room for new ones.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from pathlib import Path

from gcs_coloc.recorder.formats.mcap_file import END_MARK, McapEncoder
from gcs_coloc.recorder.journal import Entry

_IN_USE_S = 60.0
"""A file that was written to so lately may be another service's, which writes once a second. Chosen for a slow disk."""


class LogSegment:
    """Two files `NAME.tlog` and `NAME.mcap`, new. OSError where they cannot be made or written."""

    def __init__(self, directory: Path, name: str) -> None:
        self._tlog = _File(directory / f"{name}.tlog")
        try:
            self._mcap = _File(directory / f"{name}.mcap", END_MARK)
        except OSError:
            self._tlog.close()
            raise
        self._encoder = McapEncoder()

    @property
    def size(self) -> int:
        """The bytes written so far, of both files."""
        return self._tlog.size + self._mcap.size

    def write(self, records: bytes, entries: list[Entry]) -> None:
        """Write records to the tlog and entries to the MCAP file.

        From then on they outlive this process, but not yet a loss of power.
        """
        self._tlog.append(records)
        for entry in entries:
            self._encoder.add(entry)
        self._mcap.append(self._encoder.pop())

    def sync(self) -> None:
        """Sync both files to the disk, so that they outlive a loss of power.

        Raises OSError where a file was deleted.
        """
        self._tlog.sync()
        self._mcap.sync()

    def close(self, *, whole: bool = True) -> None:
        """Close both files; `whole`: end the MCAP file with its index. OSError where that cannot be written.

        A file that nothing could be written to is removed.
        """
        try:
            if whole:
                self._mcap.append(self._encoder.finish(), last=True)
        finally:
            self._tlog.close()
            self._mcap.close()


def delete_oldest(directory: Path, most_bytes: int) -> None:
    """Delete the oldest log segments, both files of each, until the rest takes at most `most_bytes`.

    A segment that was written to in the last minute is not touched.
    """
    found: dict[str, dict[Path, os.stat_result]] = {}
    for path in directory.glob("gcs-coloc-*"):
        if path.suffix in (".tlog", ".mcap"):
            found.setdefault(path.stem, {})[path] = path.stat()
    segments = [
        (max(about.st_mtime for about in files.values()), sum(about.st_size for about in files.values()), list(files))
        for files in found.values()
    ]
    total = sum(size for _, size, _ in segments)
    newest_s = time.time() - _IN_USE_S
    for written_s, size, paths in sorted(segments):
        if total <= most_bytes or written_s > newest_s:
            return
        for path in paths:
            path.unlink()
        total -= size


class _File:
    """A new file of whole appends: an append that fails half-way is undone.

    `end_mark` stands behind the last append at every moment and is written over by the next.
    """

    def __init__(self, path: Path, end_mark: bytes = b"") -> None:
        self._path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._end_mark = end_mark
        self.size = 0

    def append(self, data: bytes, *, last: bool = False) -> None:
        if not data:
            return
        try:
            self._write(self.size, data if last else data + self._end_mark)
        except OSError:
            os.ftruncate(self._fd, self.size)
            with contextlib.suppress(OSError):
                self._write(self.size, self._end_mark)
            raise
        self.size += len(data)

    def sync(self) -> None:
        os.fdatasync(self._fd)
        if os.fstat(self._fd).st_nlink == 0:
            # The system goes on accepting data for a deleted file.
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self._path))

    def close(self) -> None:
        if self.size == 0:
            with contextlib.suppress(OSError):
                self._path.unlink()
        os.close(self._fd)

    def _write(self, at: int, data: bytes) -> None:
        view = memoryview(data)
        while view:
            written = os.pwrite(self._fd, view, at)
            view, at = view[written:], at + written
