"""The process's standard streams, which whoever starts it may have closed, and whose reader may go."""

from __future__ import annotations

import contextlib
import errno
import os
import sys

NOBODY_READS = (errno.EPIPE, errno.ENOSPC, errno.EIO)
"""What writing to a standard output ends with whose reader, disk or terminal is gone."""


def open_all() -> None:
    """Make stdin, stdout and stderr exist. One that is closed is nothing to read from, and nowhere to write to.

    Else the next socket or file that is opened gets its number, and what is printed goes there.
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
    """Write what stdout still holds to nowhere, so that the interpreter does not stumble over it as it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
