"""Log lines written by a thread of their own: whoever does not read them must not hold the service up, nor its end."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading
from logging.handlers import QueueHandler
from typing import TextIO

MOST_WAITING = 2000
_LAST_LINES_S = 2.0


class LineHandler(logging.Handler):
    """Writes each record as a line. Unlike the library's, it is not flushed as the program ends: that could wait for ever."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        print(self.format(record), file=self._stream, flush=True)


def own_stream(stream: TextIO) -> TextIO:
    """The same file as a stream of its own, for a thread that is held up in writing keeps its stream locked.

    What is no file is given back as it is.
    """
    try:
        number = os.dup(stream.fileno())
    except (OSError, ValueError):
        return stream
    return os.fdopen(number, "w", encoding=stream.encoding, errors=stream.errors)


class LogWriter(QueueHandler):
    """Hands records to `handler` on a thread. While that is held up, `most` records wait; the newest beyond them are lost.

    A pipe that nobody reads is full after 64 kB, and then every write to it waits for ever.
    """

    def __init__(self, handler: logging.Handler, most: int = MOST_WAITING) -> None:
        self._records: queue.Queue[logging.LogRecord | None] = queue.Queue(most)
        super().__init__(self._records)
        # The message alone, as what is queued is that: `handler` does the rest, and basicConfig would set its own form here.
        self.setFormatter(logging.Formatter("%(message)s"))
        self.lost = 0
        self._writing = threading.Thread(target=self._write, args=(handler,), name="log", daemon=True)
        self._writing.start()

    def enqueue(self, record: logging.LogRecord) -> None:
        """Queue a record; never waits."""
        try:
            self._records.put_nowait(record)
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Write what waits, as the program ends; where nobody reads, it is given up after a moment."""
        with contextlib.suppress(queue.Full):
            self._records.put_nowait(None)
            self._writing.join(_LAST_LINES_S)
        super().close()

    def _write(self, handler: logging.Handler) -> None:
        while (record := self._records.get()) is not None:
            # Not `handle`, whose lock the logging module waits for as the program ends.
            with contextlib.suppress(OSError, ValueError):
                handler.emit(record)
