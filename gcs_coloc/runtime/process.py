"""The process: its standard streams, the threads of its linear algebra, its garbage collection."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import sys

NOBODY_READS = (errno.EPIPE, errno.ENOSPC, errno.EIO)
"""The errors of writing to a standard output whose reader, disk space or terminal is gone."""
_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_YOUNG_OBJECTS = 50_000
"""New objects before they are searched for cycles. Chosen: cycles may keep some 10 MB for a while."""
_YOUNG_SEARCHES = 20
"""Searches of the young objects before one of the middle generation. Chosen: twice Python's default."""
_MIDDLE_SEARCHES = 50
"""Searches of the middle generation before one of all objects. Chosen: five times Python's default."""


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


def one_thread() -> None:
    """Limit linear algebra to one thread, in this process and its children. Called before anything imports numpy, which reads it.

    For the filter's matrices of some 100 rows, several threads are slower than one, and on a busy machine they need many times
    the CPU. Variables that the user has set stay.
    """
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")


def collect_seldom() -> None:
    """Exclude all objects of the start from garbage collection for ever, and search later ones for cycles seldom.

    Reference counting frees nearly everything that a flight allocates. By default Python searches the young objects whenever 700
    more are alive than before, and now and then all objects: with many fleets that takes a sixth of the CPU, and can delay an
    output by a quarter of a second.
    """
    gc.freeze()
    gc.set_threshold(_YOUNG_OBJECTS, _YOUNG_SEARCHES, _MIDDLE_SEARCHES)
