"""Log lines written on a thread of their own: a full or closed stderr must delay neither the service nor its end."""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading
from logging.handlers import QueueHandler, QueueListener
from typing import TextIO

MAX_WAITING = 2000
"""Records that wait for a slow reader. Chosen: a minute of a busy start at 30 lines a second, some 1 MB."""
_LAST_LINES_S = 2.0
"""How long the end of the program waits for the last lines. Chosen: a slow terminal, and no longer than a person waits."""


class LineHandler(logging.Handler):
    """Writes each record as a line. It is not flushed as the program ends, as a StreamHandler is: that could wait for ever."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        print(self.format(record), file=self._stream, flush=True)


def own_stream(stream: TextIO) -> TextIO:
    """The same file as a stream of its own, as a thread that hangs in writing keeps its stream locked.

    A stream without a file is returned as it is.
    """
    try:
        number = os.dup(stream.fileno())
    except (OSError, ValueError):
        return stream
    return os.fdopen(number, "w", encoding=stream.encoding, errors=stream.errors)


class LogWriter(QueueHandler):
    """Passes records to `handler` on a thread. While that hangs, `most` records wait; the newest beyond them are lost.

    A pipe that nobody reads is full after 64 kB (pipe(7)); from then on every write to it hangs.
    """

    def __init__(self, handler: logging.Handler, most: int = MAX_WAITING) -> None:
        records: queue.Queue[logging.LogRecord] = queue.Queue(most)
        super().__init__(records)
        # The message alone is queued; `handler` does the rest. Without a formatter, basicConfig would set one here.
        self.setFormatter(logging.Formatter("%(message)s"))
        self.lost = 0
        self._listener = _Listener(records, handler)
        self._listener.start()

    def enqueue(self, record: logging.LogRecord) -> None:
        """Queue a record; never waits."""
        try:
            self.queue.put_nowait(record)
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Write what waits, as the program ends; where nobody reads, give up after a moment."""
        # On a thread, as the listener's stop waits for the last line without a limit.
        ending = threading.Thread(target=self._stop, daemon=True)
        ending.start()
        ending.join(_LAST_LINES_S)
        super().close()

    def _stop(self) -> None:
        with contextlib.suppress(queue.Full):
            self._listener.stop()


class _Listener(QueueListener):
    def handle(self, record: logging.LogRecord) -> None:
        """Write one record. Without the handler's lock, which the logging module waits for as the program ends."""
        for handler in self.handlers:
            with contextlib.suppress(OSError, ValueError):
                handler.emit(record)
