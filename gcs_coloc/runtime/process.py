"""The process: standard streams, secret files, threads of linear algebra, garbage collection."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import signal
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from gcs_coloc.core.errors import ConfigError

NOBODY_READS = (errno.EPIPE, errno.ENOSPC, errno.EIO)
"""The errors of writing to a standard output whose reader, disk space or terminal is gone."""
_MAX_SECRET_BYTES = 4096
"""Chosen: longer than any passphrase or token; more of a file is not read."""
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
    """Limit linear algebra to one thread, in this process and its children.

    Call it before anything imports numpy, which reads the limit.
    For the filter's matrices of some 100 rows, several threads are slower than one, and on a busy machine they need many times
    the CPU. Variables that the user has set stay.
    """
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")


def collect_seldom() -> None:
    """Let the garbage collector search for cycles seldom. It may be called again at any time.

    Reference counting frees nearly everything that a flight allocates. By default Python searches the young objects whenever 700
    more are alive than before, and now and then all objects: with many fleets that, with what `exclude_start` spares, takes a
    sixth of the CPU, and can delay an output by a quarter of a second.
    """
    gc.set_threshold(_YOUNG_OBJECTS, _YOUNG_SEARCHES, _MIDDLE_SEARCHES)


def exclude_start() -> None:
    """Exclude all objects that exist by now from garbage collection.

    It is called at the end of a service's start. What is garbage by then is never freed.
    """
    gc.freeze()


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """Search for no cycles while modules are imported, and exclude what they make for ever.

    It stays, and each search of it takes 20 ms.
    """
    gc.disable()
    try:
        yield
    finally:
        exclude_start()
        gc.enable()


def read_private_file(path: Path, what: str, setting: str = "") -> bytes:
    """Read a secret from a file that its owner alone can use.

    `what` it is and the `setting` that names it stand in errors.

    Raises:
        ConfigError: the file cannot be read, or can be used by others than its owner.
    """
    where = f"{setting}: {path}" if setting else str(path)
    try:
        # O_NONBLOCK: a pipe in place of the file must not block the program.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            # Of the open file, not of the path: what is checked is what is read.
            mode = os.fstat(file.fileno()).st_mode
            if not stat.S_ISREG(mode):
                raise ConfigError(f"{where}: is no file")
            if mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise ConfigError(f"{where}: {what} can be used by others (mode {stat.S_IMODE(mode):04o}); run: chmod 600 {path}")
            return file.read(_MAX_SECRET_BYTES)
    except OSError as error:
        raise ConfigError(f"{where}: {what} cannot be read: {error.strerror}") from None


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Have Ctrl-C, SIGTERM and SIGHUP call `stop`, in the event loop that runs.

    SIGHUP: the terminal was closed or its connection broke, and the aided vehicles must learn of it. Under nohup, which has it
    ignored, the flight goes on.
    """
    import asyncio  # not above: this module is read before garbage is collected seldom

    ending = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        ending.append(signal.SIGHUP)
    for sign in ending:
        asyncio.get_running_loop().add_signal_handler(sign, stop)
