"""The service, the composition root: builds each fleet's path and its observers, runs and ends them."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Coroutine, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from gcs_coloc.config.fleets import FleetOf
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.errors import GcsColocError, WebError
from gcs_coloc.core.messages.control import CommandSource
from gcs_coloc.recorder.journal import EVERY_S
from gcs_coloc.runtime.clock import ServiceClock, read_host_clock
from gcs_coloc.runtime.process import exclude_start, stop_on_signals
from gcs_coloc.service.fleet_service import FleetService
from gcs_coloc.sinks import console as console_sink

if TYPE_CHECKING:
    from gcs_coloc.service.worker import SupervisorLink, WorkerReport
    from gcs_coloc.sinks.mqtt import Mqtt
    from gcs_coloc.sinks.terminal import SharedConsole
    from gcs_coloc.web.server import WebServer

log = logging.getLogger("gcs_coloc")

_TABLE_EVERY_S = 0.5
"""Snapshots for the table on a terminal. Chosen: as often as a person can read."""
_SAMPLE_EVERY_S = 1.0
"""Snapshots for the page's history; the page requests those that it shows live by itself."""
_HEARTBEAT_EVERY_S = 1.0
"""MAVLink's customary rate of HEARTBEAT (mavlink.io, heartbeat protocol)."""
_REFUSALS_EVERY_S = 10.0
"""Chosen: one line about refusals in this time is what a person can use."""
_STATISTICS = "scipy.special"
"""What the tests of ranges need as soon as some have come: a quarter of a second."""
_MQTT_PACKAGES = ("aiomqtt", "gcs_coloc.sinks.mqtt")
_WEB_PACKAGES = ("starlette.applications", "prometheus_client", "uvicorn", "gcs_coloc.web.app", "gcs_coloc.web.server")
"""What the page needs, in pieces that take some 50 ms each."""


class Service:
    """The fleets, each with its observers. `run` lasts until a signal or until `stop` is called."""

    def __init__(self, fleets: Sequence[FleetOf], supervisor: SupervisorLink | None = None) -> None:
        """`supervisor` is the connection to it where this is its worker process, of one fleet."""
        self._supervisor = supervisor
        self._clock = ServiceClock()
        self._stopping = asyncio.Event()
        self._fleets = [self._observed(fleet) for fleet in fleets]

    def _observed(self, fleet: FleetOf) -> _Observed:
        with fleet.named():
            return _Observed(fleet, self._clock, self._stopping)

    def stop(self) -> None:
        """Request the service to end in order."""
        self._stopping.set()

    async def run(self, terminal: SharedConsole | None) -> None:
        """Open the links and serve until `stop`; then end the fix of every aided vehicle.

        Without a terminal there is no table.

        Raises:
            LinkError: a link cannot be opened.
            WebError: the page's address was asked for and cannot be had.
        """
        stop_on_signals(self.stop)
        exclude_start()
        failure: GcsColocError | None = None
        events = {fleet.name: fleet.path.events.subscribe() for fleet in self._fleets}
        try:
            for fleet in self._fleets:
                await fleet.path.open()
            async with asyncio.TaskGroup() as group:
                background = [group.create_task(console_sink.show(events, terminal))]
                for number, fleet in enumerate(self._fleets):
                    # Not all at once: what many fleets do in the same moment delays what is to be sent.
                    background += fleet.start(group, number / len(self._fleets), on_terminal=terminal is not None)
                try:
                    for fleet in self._fleets:
                        await fleet.start_observers(group)
                    if self._supervisor is not None:
                        background += [group.create_task(run) for run in self._work_for(self._supervisor)]
                    exclude_start()
                    await self._stopping.wait()
                except GcsColocError as error:
                    failure = error
                for fleet in self._fleets:
                    fleet.stop()
                for task in background:
                    task.cancel()
        finally:
            for fleet in self._fleets:
                await fleet.close()
        if failure is not None:
            raise failure

    def _work_for(self, supervisor: SupervisorLink) -> list[Coroutine[Any, Any, None]]:
        """Return the tasks of a worker: reports to the supervisor, and its end with the supervisor's."""
        from gcs_coloc.service.worker import REPORT_EVERY_S

        async def end_with_it() -> None:
            await supervisor.wait_until_gone()
            if not self._stopping.is_set():
                log.error("the supervisor has gone: this fleet's process ends")
                self.stop()

        (fleet,) = self._fleets
        return [end_with_it(), supervisor.send_reports(fleet.report, fleet.path.idle.every(REPORT_EVERY_S))]


class _Observed:
    """One fleet's path with its observers: the page and the broker."""

    def __init__(self, fleet: FleetOf, clock: ServiceClock, stopping: asyncio.Event) -> None:
        self.name = fleet.name
        self._fleet = fleet
        self.path = FleetService(fleet.settings, clock, read_host_clock(clock()), fleet.flagged)
        self._clock = clock
        self._stopping = stopping
        self._web: WebServer | None = None
        self._mqtt: Mqtt | None = None
        self._page: str | None = None

    def report(self) -> WorkerReport:
        """Return the fleet's state, for the supervisor."""
        from gcs_coloc.service.worker import REPORT_EVERY_S, WorkerReport
        from gcs_coloc.sinks.fleet_overview import fleet_overview

        snapshot = self.path.snapshots.recent_snapshot()
        alarms = self.path.alarms.update(snapshot)
        overview = fleet_overview(snapshot, alarms, host=socket.gethostname(), every_s=REPORT_EVERY_S)
        return WorkerReport(page=self._page, overview=overview)

    def start(self, group: asyncio.TaskGroup, phase: float, *, on_terminal: bool) -> list[asyncio.Task[None]]:
        """Start the flight's tasks and return those to cancel.

        The periodic ones begin at `phase` (0 to 1) of their periods.
        Snapshots are made as often as an observer shows them: seldom where there is neither a page nor a live table.
        """
        watched_s = _SAMPLE_EVERY_S if self._fleet.settings.web.on else console_sink.PLAIN_EVERY_S
        self.path.start()
        periodic = (
            (_TABLE_EVERY_S if on_terminal else watched_s, self.path.publish_snapshot),
            (_HEARTBEAT_EVERY_S, self._each_second),
            (_REFUSALS_EVERY_S, self.path.publish_refusals),
        )
        return [group.create_task(self._every(period_s, phase, act)) for period_s, act in periodic]

    async def start_observers(self, group: asyncio.TaskGroup) -> None:
        """Start page and broker.

        What the first message does not need is imported only here, package by package: vehicles are heard between.

        Raises:
            WebError: the page's address was asked for and cannot be had.
            ConfigError: a file of theirs is of no use.
        """
        settings = self._fleet.settings
        # Not on a thread: it would hold the interpreter while a busy machine has it wait, and the flight with it.
        mqtt, web = _MQTT_PACKAGES if settings.mqtt.host else (), _WEB_PACKAGES if settings.web.on else ()
        for package in (_STATISTICS, *mqtt, *web):
            import_module(package)
            await asyncio.sleep(0)
        with self._fleet.named():
            self._mqtt = self._make_mqtt(settings)
            self._web = self._make_web(settings)
        if self._mqtt is not None:
            group.create_task(self._mqtt.run())
        if self._web is None:
            return
        try:
            self._page = self._web.open()
            log.info("%sweb page: %s", f"fleet {self.name}: " if self.name else "", self._page)
        except WebError as error:
            if self._web.must_open:
                raise WebError(f"{error}; or leave the page out: --no-web") from None
            log.warning("%s; the flight goes on without the page", error)
            self._web = None
        else:
            group.create_task(self._web.run())

    def stop(self) -> None:
        """Receive nothing more, and request the observers to end."""
        self.path.stop()
        if self._web is not None:
            self._web.stop()
        if self._mqtt is not None:
            self._mqtt.stop()

    async def close(self) -> None:
        """End the fix of every aided vehicle, and close everything."""
        await self.path.close()
        if self._web is not None:
            self._web.close()

    async def _every(self, period_s: float, phase: float, act: Callable[[], None]) -> None:
        async for _ in self.path.idle.every(period_s, phase):
            act()

    def _each_second(self) -> None:
        self.path.each_second(read_host_clock(self._clock()))

    def _make_web(self, settings: Settings) -> WebServer | None:
        if not settings.web.on:
            return None
        from gcs_coloc.web.app import WebHooks
        from gcs_coloc.web.pages import Pages
        from gcs_coloc.web.picture import LiveSource
        from gcs_coloc.web.server import WebServer

        path, snapshots = self.path, self.path.snapshots
        source = LiveSource(snapshots.snapshot, snapshots.recent_snapshot, path.alarms.update, path.truths.values)
        events = path.events.subscribe(256)
        # At the recording's pace, so that one snapshot of the fleet serves both.
        pages = Pages(source, path.idle, EVERY_S)
        command = partial(path.apply_command, source=CommandSource.PAGE)
        hooks = WebHooks(
            snapshots.snapshot, command, path.alarms.acknowledge, self._fault, path.command_refusal, path.order_standby
        )
        return WebServer(settings.web, hooks, pages, lambda: source.follow(events))

    def _make_mqtt(self, settings: Settings) -> Mqtt | None:
        if not settings.mqtt.host:
            return None
        from gcs_coloc.sinks.mqtt import Mqtt
        from gcs_coloc.sinks.mqtt_inbox import MqttHooks

        path = self.path
        command = partial(path.apply_command, source=CommandSource.MQTT)
        hooks = MqttHooks(
            path.snapshots.snapshot,
            path.known_sysids,
            command,
            path.add_range,
            self._clock,
            path.command_refusal,
            path.order_standby,
            path.alarms.update,
        )
        return Mqtt(settings.mqtt, hooks, path.events.subscribe(256), path.counts, path.idle)

    def _fault(self) -> str | None:
        """Why the service does not do its work; None where it does."""
        return "the service is ending" if self._stopping.is_set() else self.path.fault()
