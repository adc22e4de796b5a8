"""One fleet's worker process and its supervisor: what either sees of the other."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import socket
import subprocess
from collections.abc import AsyncIterator, Callable, Sequence

from pydantic import BaseModel, ConfigDict, ValidationError

from gcs_coloc.core.errors import UsageError
from gcs_coloc.sinks.fleet_overview import FleetOverview

log = logging.getLogger("gcs_coloc")

REPORT_EVERY_S = 1.0
"""Chosen: as often as the fleet is published over MQTT."""
MAX_REPORT_BYTES = 4_000_000
"""Chosen: a fleet of 255 vehicles with 2000 alarms has a tenth of it."""
_FIRST_PAUSE_S = 0.1
"""Before a worker that died is started again. Chosen: little beside the second of a start; an aircraft may depend on it."""
_LONGEST_PAUSE_S = 5.0
"""The pause doubles with each death up to this. Chosen: what cannot start costs a fifth of a core at most."""
_STEADY_S = 30.0
"""A worker that lived for so long is started again after the first pause. Chosen: longer than whatever fails at a start."""


class WorkerReport(BaseModel):
    """A line from worker to supervisor: how the fleet stands.

    `page` is the address of the fleet's own page, None where it has none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    page: str | None
    overview: FleetOverview


class SupervisorLink:
    """The worker's end of the connection to its supervisor.

    `descriptor` is of a socket that the supervisor made, and that closes when the supervisor dies.
    """

    def __init__(self, descriptor: int) -> None:
        """UsageError where it is no socket."""
        try:
            self._socket = socket.socket(fileno=descriptor)
        except OSError:
            raise UsageError(f"--supervisor {descriptor}: is no socket; leave it to the supervisor") from None
        self._writer: asyncio.StreamWriter | None = None

    async def wait_until_gone(self) -> None:
        """Return once the supervisor has gone, however it ended."""
        reader, self._writer = await asyncio.open_connection(sock=self._socket)
        try:
            while await reader.read(1024):
                pass
        except ConnectionError:
            pass

    async def send_reports(self, report: Callable[[], WorkerReport], slots: AsyncIterator[None]) -> None:
        """Send a report in each slot.

        A report is left out while the supervisor has not received the one before. Nothing ever waits for it.
        """
        async for _ in slots:
            writer = self._writer
            if writer is not None and not writer.is_closing() and not writer.transport.get_write_buffer_size():
                writer.write(report().model_dump_json().encode() + b"\n")


class BackOff:
    """How long to wait before a worker is started again: longer with each death, up to a bound."""

    def __init__(self) -> None:
        self._next_s = _FIRST_PAUSE_S

    def pause_s(self, lived_s: float) -> float:
        """The pause after a worker that lived for so long, s."""
        if lived_s >= _STEADY_S:
            self._next_s = _FIRST_PAUSE_S
        pause_s, self._next_s = self._next_s, min(2.0 * self._next_s, _LONGEST_PAUSE_S)
        return pause_s


class Worker:
    """The process of the fleet `name`: `program` with the options that make it that fleet's worker.

    `page` is the address of the fleet's own page, None while it is not known; `starts` counts how often it was started.
    """

    def __init__(
        self,
        name: str,
        program: Sequence[str],
        heard: Callable[[str, WorkerReport], None],
        lost: Callable[[str], None],
    ) -> None:
        """`heard` is called with each report, `lost` when the process has ended."""
        self.name = name
        self.page: str | None = None
        self.starts = 0
        self._program = program
        self._heard = heard
        self._lost = lost
        self._stopping = asyncio.Event()
        self._process: asyncio.subprocess.Process | None = None

    @property
    def runs(self) -> bool:
        """Whether there is a process."""
        return self._process is not None

    async def run(self) -> None:
        """Keep the process running until `stop`, and return once it has ended."""
        loop, back_off = asyncio.get_running_loop(), BackOff()
        while not self._stopping.is_set():
            began_s = loop.time()
            try:
                said = await self._run_once()
            except OSError as error:  # no memory, process or descriptor is left
                said = f"cannot be started: {error.strerror}"
            self.page = None
            self._lost(self.name)
            if self._stopping.is_set():
                return
            pause_s = back_off.pause_s(loop.time() - began_s)
            log.error("fleet %s: its process %s; it is started again in %.1f s", self.name, said, pause_s)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), pause_s)

    def stop(self) -> None:
        """Request the process to end in order."""
        self._stopping.set()
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End the process at once."""
        self._send(signal.SIGKILL)

    def _send(self, sign: signal.Signals) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(sign)

    async def _run_once(self) -> str:
        """Start the process, wait until it has ended, and return in words how it did.

        OSError where it cannot be started.
        """
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                self._process = await asyncio.create_subprocess_exec(
                    *self._program,
                    *("--fleet", self.name, "--supervisor", str(theirs.fileno())),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    # Ctrl-C and a terminal that closes reach the supervisor alone, which ends the workers.
                    start_new_session=True,
                )
            self.starts += 1
            log.info("fleet %s: process %d", self.name, self._process.pid)
            if self._stopping.is_set():  # meanwhile
                self.stop()
            hearing = asyncio.create_task(self._hear(ours))
            try:
                status = await self._process.wait()
                return f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with exit code {status}"
            finally:
                self._process = None
                hearing.cancel()
                await asyncio.gather(hearing, return_exceptions=True)

    async def _hear(self, ours: socket.socket) -> None:
        reader, writer = await asyncio.open_connection(sock=ours, limit=MAX_REPORT_BYTES)
        try:
            while line := await reader.readline():
                self._receive(line)
        except (ConnectionError, ValueError) as error:
            log.error("fleet %s: its process is not heard any more: %s", self.name, error)
        finally:
            writer.close()

    def _receive(self, line: bytes) -> None:
        try:
            report = WorkerReport.model_validate_json(line)
        except ValidationError as error:
            log.error("fleet %s: a report that cannot be read: %s", self.name, error.errors()[0]["msg"])
            return
        self.page = report.page
        self._heard(self.name, report)
