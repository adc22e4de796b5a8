"""Watches all fleets on an MQTT broker by what their services publish.

It publishes nothing itself.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, ValidationError

from gcs_coloc.config.service_sections import MqttConfig
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.sinks.broker_connection import BrokerConnection
from gcs_coloc.sinks.fleet_overview import FleetOverview
from gcs_coloc.sinks.mqtt_models import TOPIC_VERSION
from gcs_coloc.sinks.watched_fleets import FleetShown, Presence, WatchedFleets

log = logging.getLogger("gcs_coloc")

# A bridge between brokers puts a word of its own in the place of the prefix, so that two hosts' fleets stay two.
_TOPICS = (f"+/{TOPIC_VERSION}/+/status", f"+/{TOPIC_VERSION}/+/overview")
_MAX_PAYLOAD_BYTES = 500_000
"""Chosen: four times the longest of a fleet of 255 vehicles; a longer one is not parsed."""
_MAX_INCOMING = 4096
"""Messages of the broker that wait for us. Chosen: twice what it keeps of a thousand fleets, which all come at once."""
_WARN_EVERY_S = 60.0
"""Chosen: one line about refusals in this time is what a person can use."""


class WatchRefusal(StrEnum):
    """Why a message was refused. Its value is the `reason` label of the metric."""

    UNREADABLE = "watch_unreadable"
    """No message of ours, or one of a version that is too new."""
    TOO_LONG = "watch_too_long"
    TOO_MANY_FLEETS = "watch_too_many_fleets"


class _Status(BaseModel):
    """The part of `…/status` that is used; later versions may add fields."""

    model_config = ConfigDict(extra="ignore")
    online: bool
    estimator: str | None = None
    vehicles: tuple[int, ...] = ()

    @property
    def said(self) -> Presence | None:
        """The goodbye knows the estimator, the last will does not."""
        if self.online:
            return None
        return Presence.LOST if self.estimator is None else Presence.ENDED


class MqttWatch:
    """Keeps `WatchedFleets` up to date from one broker, as long as `run` runs.

    `clock` is any that is not stepped, s.
    """

    def __init__(self, config: MqttConfig, clock: Callable[[], float], unix_clock: Callable[[], float] = time.time) -> None:
        """Read the password and the certificates.

        Raises:
            ConfigError: a file cannot be read, or holds no certificates.
        """
        self.counts = Counts()
        self._clock = clock
        self._unix_clock = unix_clock
        self._fleets = WatchedFleets()
        self._stopping = asyncio.Event()
        self._connection = BrokerConnection(config, self._stopping, "what was heard before is shown with its age")
        self._warned: dict[str, int] = {}
        self._warned_at_s = -_WARN_EVERY_S

    @property
    def where(self) -> str:
        """The broker, as HOST:PORT."""
        return self._connection.where

    def problem(self) -> str | None:
        """Why nothing comes from the broker; None where it may."""
        found = self._connection.problem
        return f"no connection to the MQTT broker {self.where}: {found}" if found is not None else None

    def shown(self) -> tuple[FleetShown, ...]:
        """All fleets as they stand, the most serious first."""
        return self._fleets.shown(self._clock())

    async def run(self) -> None:
        """Receive until it is cancelled."""
        await self._connection.keep(self._session)

    def receive(self, topic: str, payload: bytes) -> None:
        """Add one message, or count why it is refused. Never raises for its content."""
        refusal = self._receive(topic, payload)
        if refusal is not None:
            self.counts.add(refusal)
            self._warn(topic)

    async def _session(self) -> None:
        async with self._connection.client(most_incoming=_MAX_INCOMING) as client:
            for topic in _TOPICS:
                await client.subscribe(topic)
            log.info("mqtt: connected to %s, topics %s", self.where, ", ".join(_TOPICS))
            self._connection.connected()
            async for message in client.messages:
                self.receive(message.topic.value, message.payload if isinstance(message.payload, bytes) else b"")

    def _receive(self, topic: str, payload: bytes) -> WatchRefusal | None:
        source, _, what = topic.rpartition("/")
        name = source.rpartition("/")[2]
        if not payload:
            self._fleets.forget(source)  # so a kept message is deleted
            return None
        if len(payload) > _MAX_PAYLOAD_BYTES:
            return WatchRefusal.TOO_LONG
        now_s = self._clock()
        try:
            if what == "status":
                status = _Status.model_validate_json(payload)
                taken = self._fleets.receive_connection(source, name, status.said, now_s, status.vehicles)
            else:
                overview = FleetOverview.model_validate_json(payload)
                taken = self._fleets.receive(source, name, overview, now_s, self._unix_clock())
        except ValidationError:
            return WatchRefusal.UNREADABLE
        return None if taken else WatchRefusal.TOO_MANY_FLEETS

    def _warn(self, topic: str) -> None:
        now_s = self._clock()
        if now_s - self._warned_at_s < _WARN_EVERY_S:
            return
        grown = {str(reason): times - self._warned.get(reason, 0) for reason, times in self.counts.items()}
        self._warned, self._warned_at_s = dict(self.counts), now_s
        text = ", ".join(f"{reason} {times}" for reason, times in grown.items() if times)
        log.warning(
            "mqtt: refused: %s, the last one on %s; is its service newer than this page, or the topic another's?", text, topic
        )
