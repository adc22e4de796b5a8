"""`gcs-coloc watch`: all fleets of all hosts from one MQTT broker, on page and terminal.

It reaches no vehicle.
"""

from __future__ import annotations

import asyncio
import logging
import time

from gcs_coloc.config.service_sections import MqttConfig, WebConfig
from gcs_coloc.runtime.process import exclude_start, stop_on_signals
from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.sinks.mqtt_watch import MqttWatch
from gcs_coloc.sinks.terminal import FleetsTable, LiveTable, SharedConsole, fleet_line
from gcs_coloc.sinks.watched_fleets import Presence
from gcs_coloc.web.fleets_page import FLEETS_EVERY_S, FleetsSource
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.server import WebServer

log = logging.getLogger("gcs_coloc")

_TABLE_EVERY_S = 0.5
"""Chosen: as often as a person can read."""


class Watch:
    """The page and the table of all fleets. `run` lasts until a signal."""

    def __init__(self, mqtt: MqttConfig, web: WebConfig) -> None:
        """Read the password and the certificates.

        Raises:
            ConfigError: a file cannot be read, or its content is wrong.
        """
        self._watch = MqttWatch(mqtt, time.monotonic)
        source = FleetsSource(
            self._watch.shown, f"MQTT broker {self._watch.where}", self._watch.problem, lambda: dict(self._watch.counts)
        )
        pages = Pages(source, IdleScheduler(), FLEETS_EVERY_S)
        self._web = WebServer(web, source, pages, must_serve=True) if web.on else None
        self._logged: dict[tuple[str, str], tuple[Presence, str]] = {}

    async def run(self, terminal: SharedConsole | None) -> None:
        """Watch until Ctrl-C, SIGTERM or SIGHUP.

        Raises:
            WebError: the page's address cannot be had, or the page has failed.
        """
        stopping = asyncio.Event()
        stop_on_signals(stopping.set)
        serving: asyncio.Task[None] | None = None
        if self._web is not None:
            log.info("web page: %s", self._web.open())
            serving = asyncio.create_task(self._web.run())
            serving.add_done_callback(lambda _: stopping.set())
        exclude_start()
        table = LiveTable(terminal) if terminal is not None else None
        try:
            async with asyncio.TaskGroup() as group:
                background = [group.create_task(self._watch.run()), group.create_task(self._show(table))]
                await stopping.wait()
                for task in background:
                    task.cancel()
        finally:
            if table is not None:
                table.close()
        if self._web is not None and serving is not None:
            self._web.stop()
            await serving

    async def _show(self, table: LiveTable | None) -> None:
        while True:
            if table is not None:
                table.show(FleetsTable(self._watch.shown(), self._watch.problem()))
            else:
                self._log_changes()
            await asyncio.sleep(_TABLE_EVERY_S)

    def _log_changes(self) -> None:
        """Log one line for each fleet whose presence or light has changed.

        A fleet that is heard for the first time counts as changed.
        """
        for fleet in self._watch.shown():
            state = fleet.presence, fleet.light
            if self._logged.get((fleet.source, fleet.host)) != state:
                self._logged[fleet.source, fleet.host] = state
                is_worse = fleet.light in ("bad", "caution") or fleet.presence in (Presence.STALE, Presence.LOST)
                log.log(logging.WARNING if is_worse else logging.INFO, "%s", fleet_line(fleet))
