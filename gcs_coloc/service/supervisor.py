"""The supervisor: runs each fleet in a worker process of its own.

One page and one address of metrics serve all fleets.

Workers share nothing. One that dies is started again; one that hangs or dies changes nothing for the others. A worker whose
supervisor has gone ends in order, so that no vehicle is ever fed by a worker of an earlier supervisor.
"""

from __future__ import annotations

import asyncio
import logging
import time
import urllib.request
from collections.abc import Mapping, Sequence
from http.client import HTTPException

from prometheus_client.core import Metric

from gcs_coloc.config.fleets import FleetOf
from gcs_coloc.core.errors import WebError
from gcs_coloc.runtime.process import stop_on_signals
from gcs_coloc.service.worker import Worker, WorkerReport
from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.sinks.metrics import merged_metrics, read_metrics, worker_metrics
from gcs_coloc.sinks.watched_fleets import FleetShown, Presence, WatchedFleets
from gcs_coloc.web.fleets_page import FLEETS_EVERY_S, FleetsSource
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.server import WebServer

log = logging.getLogger("gcs_coloc")

_END_WITHIN_S = 4.0
"""A worker that has not ended by then is killed. Chosen: twice what one needs, and less than systemd's TimeoutStopSec=5."""
_SCRAPE_WITHIN_S = 1.0
"""A worker that does not answer by then has no metrics this time. Chosen: Prometheus gives up after ten."""
_LOOK_EVERY_S = 1.0  # chosen: a worker that died starts again within a second
_WORKERS = "worker processes on this computer"


class Supervisor:
    """The workers of all fleets and their page. `program` is the command line that started this process."""

    def __init__(self, fleets: Sequence[FleetOf], program: Sequence[str]) -> None:
        self._watched = WatchedFleets()
        self._stopping = asyncio.Event()
        self._workers = {fleet.name: Worker(fleet.name, program, self._heard, self._lost) for fleet in fleets}
        self._config = fleets[0].settings.service.web()
        self._is_shown = any(fleet.settings.web.on for fleet in fleets)
        self._was_silent: set[str] = set()

    def stop(self) -> None:
        """Request all workers, and the supervisor, to end in order."""
        self._stopping.set()

    async def run(self) -> None:
        """Serve until `stop`.

        Raises:
            WebError: the page's address was asked for and cannot be had.
        """
        stop_on_signals(self.stop)
        web = self._open_page()
        for name in self._workers:
            self._watched.receive_connection(name, name, None, time.monotonic())
        workers = [asyncio.create_task(worker.run()) for worker in self._workers.values()]
        looking = asyncio.create_task(self._report_silent())
        serving = [asyncio.create_task(web.run())] if web is not None else []
        try:
            await self._stopping.wait()
        finally:
            looking.cancel()
            for worker in self._workers.values():
                worker.stop()
            if web is not None:
                web.stop()
            await asyncio.wait(workers, timeout=_END_WITHIN_S)
            for worker in self._workers.values():
                if worker.runs:
                    log.error("fleet %s: its process does not end, and is killed", worker.name)
                    worker.kill()
            await asyncio.gather(*workers, *serving)

    def _open_page(self) -> WebServer | None:
        if not self._is_shown:
            return None
        source = _Source(self)
        web = WebServer(self._config, source, Pages(source, IdleScheduler(), FLEETS_EVERY_S))
        try:
            log.info("page of all fleets: %s", web.open())
        except WebError as error:
            if web.must_open:
                raise WebError(f"{error}; or set another address in [service]") from None
            log.warning("%s; the flight goes on without the page of all fleets", error)
            return None
        return web

    def _heard(self, name: str, report: WorkerReport) -> None:
        self._watched.receive(name, name, report.overview, time.monotonic(), time.time())

    def _lost(self, name: str) -> None:
        said = Presence.ENDED if self._stopping.is_set() else Presence.LOST
        self._watched.receive_connection(name, name, said, time.monotonic())

    async def _report_silent(self) -> None:
        """Log workers that run and send no reports."""
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            silent = {fleet.name: fleet.text for fleet in self.shown() if fleet.presence is Presence.STALE}
            for name in silent.keys() - self._was_silent:
                log.error("fleet %s: its process hangs: %s", name, silent[name])
            for name in self._was_silent - silent.keys():
                log.warning("fleet %s: its process does not hang any more", name)
            self._was_silent = set(silent)

    def shown(self) -> tuple[FleetShown, ...]:
        """Return all fleets in their present state, each with the address of its own page."""
        fleets = self._watched.shown(time.monotonic())
        return tuple(fleet.model_copy(update={"page": self._workers[fleet.name].page}) for fleet in fleets)

    def problem(self) -> str | None:
        """Return which fleets are not heard, in words; None where all are."""
        problems = [f"fleet {fleet.name}: {fleet.text}" for fleet in self.shown() if fleet.presence is not Presence.LIVE]
        return "; ".join(sorted(problems)) or None

    def worker_metrics(self) -> list[Metric]:
        """Of the processes themselves."""
        is_heard = {fleet.name: fleet.presence is Presence.LIVE for fleet in self.shown()}
        return worker_metrics(is_heard, {worker.name: worker.starts for worker in self._workers.values()})

    async def fleet_metrics(self) -> list[tuple[Mapping[str, str], list[Metric]]]:
        """Return the metrics of each fleet that answers, with the fleet's label."""
        pages = {worker.name: worker.page for worker in self._workers.values() if worker.page is not None}
        found = await asyncio.gather(*(asyncio.to_thread(_scrape, page) for page in pages.values()))
        return [({"fleet": name}, families) for name, families in zip(pages, found, strict=True)]


class _Source(FleetsSource):
    """What the page of all fleets shows, and the metrics of all."""

    def __init__(self, supervisor: Supervisor) -> None:
        super().__init__(supervisor.shown, _WORKERS, supervisor.problem)
        self._supervisor = supervisor

    async def metrics(self) -> bytes:
        """As `FleetsSource` says, with those of every fleet."""
        of_fleets = await self._supervisor.fleet_metrics()
        own = [*self.registry.collect(), *self._supervisor.worker_metrics()]
        return merged_metrics([({}, own), *of_fleets])


def _scrape(page: str) -> list[Metric]:
    """The metrics at a fleet's page; none where it does not answer."""
    # No proxy of the environment: the page is on this computer.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(f"{page}metrics", timeout=_SCRAPE_WITHIN_S) as answer:
            return read_metrics(answer.read().decode())
    except (OSError, HTTPException, ValueError):
        return []
