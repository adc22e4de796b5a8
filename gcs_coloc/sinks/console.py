"""The operator's console: a live table on a terminal, plain log lines elsewhere.

Both are written by threads of their own.
A terminal that is stopped (Ctrl-S), or a full or closed pipe, must delay neither the service nor its end.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import queue
import sys
import threading
from collections.abc import Mapping
from logging.handlers import QueueHandler, QueueListener
from typing import TYPE_CHECKING, TextIO

from gcs_coloc.core.messages.outbound import ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.sinks.event_bus import Subscription, level_and_text
from gcs_coloc.sinks.fleet_lines import out_line, standby_line, vehicle_line

if TYPE_CHECKING:
    from gcs_coloc.sinks.terminal import LiveTable, SharedConsole

log = logging.getLogger("gcs_coloc")

_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
PLAIN_EVERY_S = 5.0
"""Period of the log lines of all vehicles where there is no terminal. Chosen: a log of a day stays readable."""
MAX_WAITING = 2000
"""Records that wait for a slow reader. Chosen: a minute of a busy start at 30 lines a second, some 1 MB."""
_LAST_LINES_S = 2.0
"""How long the end of the program waits for the last lines. Chosen: a slow terminal, and no longer than a person waits."""


async def show(events: Mapping[str, Subscription], terminal: SharedConsole | None) -> None:
    """Show the events of each fleet, by its name, for ever.

    They are shown as live tables on the terminal, else as log lines.
    """
    async with asyncio.TaskGroup() as group:
        if terminal is None:
            for name, subscription in events.items():
                group.create_task(_log_lines(name, subscription))
            return
        from gcs_coloc.sinks.terminal import LiveTable

        snapshots: dict[str, FleetSnapshot] = {}
        live = LiveTable(terminal)
        try:
            followers = [
                group.create_task(_show_snapshots(name, subscription, snapshots, live)) for name, subscription in events.items()
            ]
            await asyncio.wait(followers)
        finally:
            live.close()


async def _show_snapshots(name: str, subscription: Subscription, snapshots: dict[str, FleetSnapshot], live: LiveTable) -> None:
    from gcs_coloc.sinks.terminal import FleetTables

    while True:
        event = await subscription.get()
        if isinstance(event, FleetSnapshot):
            snapshots[name] = event
            live.show(FleetTables(dict(snapshots)))
        elif isinstance(event, ToOperator):
            _log_event(name, event)


async def _log_lines(name: str, subscription: Subscription) -> None:
    due_s = float("-inf")
    while True:
        event = await subscription.get()
        if isinstance(event, ToOperator):
            _log_event(name, event)
        elif isinstance(event, FleetSnapshot) and event.at_s >= due_s:
            due_s = event.at_s + PLAIN_EVERY_S
            for vehicle in event.vehicles:
                log.info("%s%s", _of(name), vehicle_line(vehicle))
            for out in event.outs:
                log.info("%s%s", _of(name), out_line(out))
            if event.standby is not None:
                log.info("%s%s", _of(name), standby_line(event.standby))


def _of(name: str) -> str:
    """The beginning of a line about a fleet; one that is alone has no name."""
    return f"{name}: " if name else ""


def _log_event(name: str, event: ToOperator) -> None:
    level, text = level_and_text(event)
    who = f"vehicle {event.sysid}: " if event.sysid is not None else ""
    log.log(_LEVELS[level], "%s%s%s", _of(name), who, text)


def terminal_of(stream: TextIO) -> SharedConsole | None:
    """A console on the terminal behind `stream`, by a stream of its own; None where there is none.

    A service without a terminal starts without what draws on one: it is not imported.
    """
    if not stream.isatty():
        return None
    from gcs_coloc.sinks.terminal import SharedConsole

    console = SharedConsole(file=own_stream(stream))
    return console if console.is_terminal else None


def log_to_stderr(level: str, terminal: SharedConsole | None, whose: str = "") -> None:
    """Write the log from now on above the table on the terminal, else to stderr.

    There each line begins with `whose` it is, where that is stated.
    """
    handler: logging.Handler
    if terminal is not None:
        from rich.logging import RichHandler

        handler = RichHandler(console=terminal, show_path=False)
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = LineHandler(own_stream(sys.stderr))
        handler.setFormatter(_NamedLines(whose) if whose else logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    logging.basicConfig(level=level, handlers=[LogWriter(handler)], force=True)


def log_uncaught() -> None:
    """Log Python's warnings and uncaught faults.

    Otherwise they go to stderr as lines that do not begin with the fleet's name.
    """
    logging.captureWarnings(True)
    sys.excepthook = lambda *fault: log.critical("a fault of the program", exc_info=fault)
    threading.excepthook = lambda fault: log.critical(
        "a fault of the program", exc_info=(fault.exc_type, fault.exc_value or fault.exc_type(), fault.exc_traceback)
    )


class _NamedLines(logging.Formatter):
    """Begins every line of a record with the time, the level and the fleet's name, `whose`.

    The lines of a traceback are included.
    """

    def __init__(self, whose: str) -> None:
        super().__init__("%(message)s")
        self._whose = whose

    def format(self, record: logging.LogRecord) -> str:
        head = f"{self.formatTime(record)} {record.levelname} {self._whose}"
        return "\n".join(head + line for line in super().format(record).splitlines() or [""])


class LineHandler(logging.Handler):
    """Writes each record as a line.

    It is not flushed as the program ends, as a StreamHandler is: that could wait for ever.
    """

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
    """Passes log records to `handler` on a thread of its own.

    While that hangs, `most` records wait; the newest beyond them are lost.
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
        """Write one record without the handler's lock.

        The logging module waits for that lock as the program ends.
        """
        for handler in self.handlers:
            with contextlib.suppress(OSError, ValueError):
                handler.emit(record)
