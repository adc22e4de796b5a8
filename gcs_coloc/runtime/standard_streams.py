"""The process's standard streams, which may be closed at the start, and whose reader may go away."""

from __future__ import annotations

import contextlib
import errno
import os
import sys

NOBODY_READS = (errno.EPIPE, errno.ENOSPC, errno.EIO)
"""The errors of writing to a standard output whose reader, disk space or terminal is gone."""


def open_all() -> None:
    """Make stdin, stdout and stderr exist: a closed one becomes the null device.

    Otherwise the next socket or file that is opened gets its number, and what is printed goes there.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
    for name, number in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w", closefd=False))


def discard_output() -> None:
    """Discard what stdout still buffers, so that flushing it does not fail as the interpreter ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
