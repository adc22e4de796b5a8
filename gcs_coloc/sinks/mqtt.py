"""The fleet on an MQTT broker: each vehicle's latest state, the alarms, and a last will.

The states are retained messages. A broker never delays the flight.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import math
import socket
from collections import deque
from collections.abc import Coroutine, Iterable

from aiomqtt import Client, MqttError, Will
from pydantic import BaseModel

from gcs_coloc.config.service_sections import MqttConfig
from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.sinks.broker_connection import ANSWER_WITHIN_S, BrokerConnection
from gcs_coloc.sinks.event_bus import IdleScheduler, Subscription
from gcs_coloc.sinks.fleet_overview import fleet_overview
from gcs_coloc.sinks.mqtt_inbox import MqttHooks, MqttInbox
from gcs_coloc.sinks.mqtt_models import TOPIC_VERSION, of_alarm, of_station, of_vehicle, status, unix_s

log = logging.getLogger("gcs_coloc")

_GOODBYE_S = 1.0
"""Chosen: a broker that does not answer must not delay the last messages to the vehicles for longer."""
_MAX_ALARMS = 256
"""Changes of alarms that wait for a broker, the newest. Chosen: more than a flight without one brings."""
_MAX_INCOMING = 256
"""Messages of the broker that wait for us. Chosen: a second of ranges of a large fleet."""
_BATCH = 16
"""Publications in one run of the event loop, some 20 us each: those of a large fleet all at once would delay the flight."""


class Mqtt:
    """Publishes the fleet on one broker and receives from it.

    The connection is made again for as long as the service runs. `run` never raises for what a broker does.
    """

    def __init__(self, config: MqttConfig, hooks: MqttHooks, events: Subscription, counts: Counts, idle: IdleScheduler) -> None:
        """Read the password and the certificates. It publishes in `idle`.

        Raises:
            ConfigError: a file cannot be read, or holds no certificates.
        """
        self._config = config
        self._hooks = hooks
        self._events = events
        self._idle = idle
        self._base = f"{config.prefix}/{TOPIC_VERSION}/{config.fleet}"
        self._inbox = MqttInbox(self._base, hooks, counts, commands=config.commands, ranges=config.ranges)
        self._host = socket.gethostname()
        self._alarms: deque[Alarm] = deque(maxlen=_MAX_ALARMS)
        self._stopping = asyncio.Event()
        self._connection = BrokerConnection(config, self._stopping, "the flight goes on without it")

    def stop(self) -> None:
        """Request the end of the connection, with an orderly last status; it takes two seconds at most."""
        self._stopping.set()

    async def run(self) -> None:
        """Keep the broker up to date until `stop`.

        A fault in here is logged, and the flight goes on without it.
        """
        follower = asyncio.create_task(self._follow())
        connection = asyncio.create_task(self._connection.keep(self._session))
        try:
            await self._stopping.wait()
            await asyncio.wait({connection}, timeout=_GOODBYE_S)
        finally:
            follower.cancel()
            connection.cancel()
            await asyncio.wait({follower, connection}, timeout=_GOODBYE_S)

    async def _follow(self) -> None:
        """Keep the newest changes of alarms, with or without a broker."""
        while True:
            event = await self._events.get()
            if isinstance(event, Alarm):
                self._alarms.append(event)

    async def _session(self) -> None:
        # The same name every time: a broker then ends a connection that hangs, and its will cannot follow our return.
        name = "gcs" + hashlib.sha256(self._base.encode()).hexdigest()[:20]
        will = Will(f"{self._base}/status", status(None, online=False).model_dump_json(), qos=1, retain=True)
        async with self._connection.client(most_incoming=_MAX_INCOMING, name=name, will=will) as client:
            log.info("mqtt: connected to %s, topics below %s", self._connection.where, self._base)
            self._connection.connected()
            for topic in self._inbox.topics:
                await client.subscribe(topic)
            work: tuple[Coroutine[None, None, object], ...] = (
                self._receive_all(client),
                self._publish_all(client),
                self._stopping.wait(),
            )
            tasks = [asyncio.create_task(part) for part in work]
            try:
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                # On every way out: the client says goodbye next, after which the broker keeps the last will to itself.
                if self._stopping.is_set():
                    goodbye = status(self._hooks.snapshot(), online=False).model_dump_json()
                    await client.publish(f"{self._base}/status", goodbye, qos=1, retain=True)
            for task in done:
                task.result()

    async def _receive_all(self, client: Client) -> None:
        async for message in client.messages:
            payload = message.payload if isinstance(message.payload, bytes) else b""
            self._inbox.receive(message.topic.value, payload, retained=message.retain)

    async def _publish_all(self, client: Client) -> None:
        """Publish the latest of everything at `publish_hz`, until `stop`.

        What the broker does not accept in time is never sent.
        It does not rely on being cancelled alone: before Python 3.12 `asyncio.wait_for`, in the client's `publish`, loses a
        cancellation that comes together with the broker's confirmation.
        """
        async for _ in self._idle.every(1.0 / self._config.publish_hz):
            await self._publish_latest(client)
            if self._stopping.is_set():
                return

    async def _publish_latest(self, client: Client) -> None:
        snapshot = self._hooks.snapshot()
        at_unix_s = unix_s(snapshot.at_s, snapshot)
        alarms, every_s = self._hooks.alarms(snapshot), 1.0 / self._config.publish_hz
        latest: dict[str, BaseModel] = {
            "status": status(snapshot, online=True),
            "overview": fleet_overview(snapshot, alarms, host=self._host, every_s=every_s),
        }
        for vehicle in snapshot.vehicles:
            models = of_vehicle(vehicle, at_unix_s)
            latest |= {f"{vehicle.sysid}/{name}": model for name, model in models.items()}
        latest |= {f"station/{station.station_id}": of_station(station, at_unix_s) for station in snapshot.stations}
        topics = list(latest.items())
        for start in range(0, len(topics), _BATCH):
            await self._publish_together(client, topics[start : start + _BATCH])
        while self._alarms:
            event = self._alarms.popleft()
            try:
                await client.publish(f"{self._base}/alarms", of_alarm(event, snapshot).model_dump_json(), qos=1)
            except MqttError:
                if len(self._alarms) < _MAX_ALARMS:  # where it is full, this one is the oldest
                    self._alarms.appendleft(event)
                raise

    async def _publish_together(self, client: Client, topics: Iterable[tuple[str, BaseModel]]) -> None:
        """Publish some topics together, with one time limit for all.

        A publication takes several runs of the event loop.
        """
        content = [(f"{self._base}/{topic}", model.model_dump_json()) for topic, model in topics]
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                await asyncio.gather(*(client.publish(*one, retain=True, timeout=math.inf) for one in content))
        except TimeoutError:
            raise MqttError("Operation timed out") from None
