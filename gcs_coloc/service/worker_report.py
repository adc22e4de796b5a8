"""The connection between a fleet's worker process and the supervisor: the worker tells how it stands, and ends with the other."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import AsyncIterator, Callable

from pydantic import BaseModel, ConfigDict

from gcs_coloc.core.errors import UsageError
from gcs_coloc.sinks.fleet_overview import FleetOverview

log = logging.getLogger("gcs_coloc")

REPORT_EVERY_S = 1.0
"""Chosen: as often as the fleet is published over MQTT."""
MAX_REPORT_BYTES = 4_000_000
"""Chosen: a fleet of 255 vehicles with 2000 alarms has a tenth of it."""


class WorkerReport(BaseModel):
    """A line from worker to supervisor: the address of the fleet's own page, None where it has none, and how the fleet stands."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    page: str | None
    overview: FleetOverview


class SupervisorLink:
    """The worker's end. `descriptor` is of a socket that the supervisor made, and that closes when the supervisor dies."""

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
        """Send a report in each slot; one that the supervisor is too slow for is left out, and nothing ever waits for it."""
        async for _ in slots:
            writer = self._writer
            if writer is not None and not writer.is_closing() and not writer.transport.get_write_buffer_size():
                writer.write(report().model_dump_json().encode() + b"\n")
