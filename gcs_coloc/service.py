"""The composition root: builds the fleet's path and its observers, keeps them going, and ends them in order."""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING

from rich.console import Console

from gcs_coloc.clock import ServiceClock
from gcs_coloc.config import Settings
from gcs_coloc.core.errors import WebError
from gcs_coloc.fleet_service import FleetService
from gcs_coloc.host_clock import read_host_clock
from gcs_coloc.sinks import console as console_sink

if TYPE_CHECKING:
    from gcs_coloc.sinks.mqtt import Mqtt
    from gcs_coloc.web.server import WebServer

log = logging.getLogger("gcs_coloc")

_VIEW_EVERY_S = 0.5
_HEARTBEAT_EVERY_S = 1.0
_REFUSALS_EVERY_S = 10.0


class Service:
    """One fleet and its observers. `run` lasts until a signal or until `stop` is called."""

    def __init__(self, settings: Settings) -> None:
        self._clock = ServiceClock()
        self._fleet = FleetService(settings, self._clock, read_host_clock(self._clock()))
        self._web = self._make_web(settings)
        self._mqtt = self._make_mqtt(settings)
        self._stopping = asyncio.Event()

    def stop(self) -> None:
        """Ask the service to end in order."""
        self._stopping.set()

    async def run(self, console: Console) -> None:
        """Open the links and serve until asked to stop; then tell every aided vehicle that its fix has ended.

        Raises:
            LinkError: a link cannot be opened.
            WebError: the page's address was asked for and cannot be had.
        """
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self.stop)
        try:
            await self._fleet.open()
            self._open_web()
            async with asyncio.TaskGroup() as group:
                background = [
                    group.create_task(console_sink.show(self._fleet.hub.subscribe(), console)),
                    group.create_task(self._every(_VIEW_EVERY_S, self._fleet.publish_view)),
                    group.create_task(self._every(_HEARTBEAT_EVERY_S, self._each_second)),
                    group.create_task(self._every(_REFUSALS_EVERY_S, self._fleet.tell_refusals)),
                ]
                if self._web is not None:
                    group.create_task(self._web.run())
                if self._mqtt is not None:
                    group.create_task(self._mqtt.run())
                self._fleet.start()
                await self._stopping.wait()
                if self._web is not None:
                    self._web.stop()
                if self._mqtt is not None:
                    self._mqtt.stop()
                for task in background:
                    task.cancel()
        finally:
            await self._fleet.close()
            if self._web is not None:
                self._web.close()

    async def _every(self, period_s: float, act: Callable[[], None]) -> None:
        while True:
            act()
            await asyncio.sleep(period_s)

    def _each_second(self) -> None:
        self._fleet.each_second(read_host_clock(self._clock()))

    def _make_web(self, settings: Settings) -> WebServer | None:
        if not settings.web.on:
            return None
        # Here, because a service without the page is to start without its packages.
        from gcs_coloc.web.app import Hooks
        from gcs_coloc.web.server import WebServer

        return WebServer(settings.web, Hooks(self._fleet.look, self._fleet.obey, self._fault), self._fleet.hub.subscribe(256))

    def _make_mqtt(self, settings: Settings) -> Mqtt | None:
        if not settings.mqtt.host:
            return None
        from gcs_coloc.sinks.mqtt import Mqtt
        from gcs_coloc.sinks.mqtt_inbox import Hooks

        fleet = self._fleet
        hooks = Hooks(fleet.look, fleet.heard, fleet.obey, fleet.take_range, self._clock)
        return Mqtt(settings.mqtt, hooks, fleet.hub.subscribe(256), fleet.counts)

    def _open_web(self) -> None:
        if self._web is None:
            return
        try:
            log.info("web page: %s", self._web.open())
        except WebError as error:
            if self._web.must_open:
                raise
            log.warning("%s; the flight goes on without the page", error)
            self._web = None

    def _fault(self) -> str | None:
        """Why the service does not do its work, None where it does."""
        return "the service is ending" if self._stopping.is_set() else self._fleet.fault()
