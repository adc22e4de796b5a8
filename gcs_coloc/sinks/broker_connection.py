"""A connection to an MQTT broker that is made again whenever it is lost.

The settings have its user and its certificates.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
from collections.abc import Awaitable, Callable
from pathlib import Path

from aiomqtt import Client, MqttError, Will

from gcs_coloc.config.service_sections import MqttConfig
from gcs_coloc.core.errors import ConfigError
from gcs_coloc.runtime.process import read_private_file

log = logging.getLogger("gcs_coloc")

_RECONNECT_AFTER_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""The pauses between attempts; the last one is kept until the broker is back."""
ANSWER_WITHIN_S = 5.0
"""Chosen: a broker that takes longer to answer is lost."""
_KEEPALIVE_S = 10
"""MQTT's keep alive: the broker sends the last will after one and a half of it (MQTT 3.1.1, 3.1.2.10)."""

# The client's own lines (one for each message that it drops) would drown the flight's.
_client_log = logging.getLogger("gcs_coloc.mqtt_client")
_client_log.setLevel(logging.CRITICAL)


class BrokerConnection:
    """Keeps a connection to one broker until `stopping` is set.

    A connection that is lost is followed by a new one. What a broker does never raises from `keep`.
    """

    def __init__(self, config: MqttConfig, stopping: asyncio.Event, meanwhile: str) -> None:
        """Read the password and the certificates.

        `meanwhile` says in a warning what goes on without the broker.

        Raises:
            ConfigError: a file cannot be read, or holds no certificates.
        """
        self.where = f"{config.host}:{config.port}"
        self.problem: str | None = "not connected yet"
        """Why there is no connection; None where there is one."""
        self._config = config
        self._stopping = stopping
        self._meanwhile = meanwhile
        self._password, self._tls = read_credentials(config)
        self._attempts = 0
        self._warned_of: str | None = None

    def client(self, *, most_incoming: int, name: str | None = None, will: Will | None = None) -> Client:
        """Return the client of one connection.

        A broker ends an older connection with the same `name`. Without one, the name is drawn for each connection.
        """
        return Client(
            self._config.host,
            self._config.port,
            identifier=name,
            username=self._config.username or None,
            password=self._password,
            tls_context=self._tls,
            will=will,
            keepalive=_KEEPALIVE_S,
            timeout=ANSWER_WITHIN_S,
            max_queued_incoming_messages=most_incoming,
            logger=_client_log,
        )

    def connected(self) -> None:
        """The session is connected."""
        self._attempts, self._warned_of, self.problem = 0, None, None

    async def keep(self, session: Callable[[], Awaitable[None]]) -> None:
        """Run one session after the other; a fault in one ends this with a line in the log, and nothing else."""
        try:
            while not self._stopping.is_set():
                try:
                    await session()
                    self.problem = "the connection has ended"
                except (MqttError, OSError) as error:
                    self.problem = str(error)
                    self._warn_once(str(error))
                pause_s = _RECONNECT_AFTER_S[min(self._attempts, len(_RECONNECT_AFTER_S) - 1)]
                self._attempts += 1
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stopping.wait(), pause_s)
        except Exception as error:
            self.problem = f"ended: {type(error).__name__}: {error}"
            log.error("mqtt: %s; %s", self.problem, self._meanwhile)

    def _warn_once(self, text: str) -> None:
        if text != self._warned_of and not self._stopping.is_set():
            self._warned_of = text
            log.warning("mqtt: broker %s: %s; trying again, %s", self.where, text, self._meanwhile)


def read_credentials(config: MqttConfig) -> tuple[str | None, ssl.SSLContext | None]:
    """The password, and what checks the broker's certificate; None for what is not set.

    Raises:
        ConfigError: a file cannot be read, or holds no certificates.
    """
    password = _read_password(Path(config.password_file)) if config.password_file else None
    return password, _tls(config.ca_file) if config.tls else None


def _read_password(file: Path) -> str:
    try:
        return read_private_file(file, "the password", "mqtt.password_file").decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError:
        raise ConfigError(f"mqtt.password_file: {file}: is not text in UTF-8") from None


def _tls(ca_file: str) -> ssl.SSLContext:
    try:
        return ssl.create_default_context(cafile=ca_file or None)
    except OSError as error:
        raise ConfigError(f"mqtt.ca_file: {ca_file}: no certificates can be read from it: {error}") from None
