"""Sections of the configuration about the service itself, one class a table.

They are about its page, processes, hot standby, recordings and broker.
"""

from __future__ import annotations

from ipaddress import ip_address
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from gcs_coloc.config.sections import Section


def page_address(address: str) -> str:
    """Return the HOST:PORT of a page from that, or from a PORT of 127.0.0.1.

    Raises ValueError where the text is neither.
    """
    full = address if ":" in address else f"127.0.0.1:{address}"
    host, _, port = full.rpartition(":")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"{address} is not HOST:PORT or PORT, as 127.0.0.1:8080")
    return full


class WebConfig(Section):
    """`[web]`: the live page, the metrics and the operator's commands."""

    on: bool = True
    """Serve the page, the metrics and the operator's commands."""
    address: str = "127.0.0.1:8080"
    """HOST:PORT to listen on, or PORT of 127.0.0.1; port 0 takes any free one. If the address is set and in use, the service
    ends; the default is done without."""
    allowed_hosts: tuple[str, ...] = ()
    """Names, besides IP addresses and localhost, under which the page may be opened."""
    token_file: str = ""
    """File with the operator's token, at least 16 characters; without one the page is read-only."""
    tiles: str = ""
    """A PMTiles file (version 3) of raster tiles, drawn under the map. Empty: none."""

    _full_address = field_validator("address")(page_address)

    @property
    def must_open(self) -> bool:
        """Whether the address was set by the operator, so that the service must not run without its page."""
        return "address" in self.model_fields_set

    def host_and_port(self) -> tuple[str, int]:
        """The address in its parts, an IPv6 host without its brackets."""
        host, _, port = self.address.rpartition(":")
        return host.removeprefix("[").removesuffix("]"), int(port)


class ServiceConfig(Section):
    """`[service]`: the processes of a service of several fleets."""

    processes: Literal["one", "per-fleet"] = "one"
    """`one`: all fleets in one process. `per-fleet`: each `[[fleet]]` in a process of its own, under a supervisor that starts it
    again when it dies."""
    address: str = "127.0.0.1:8080"
    """HOST:PORT of the page of all fleets and of their metrics, with `per-fleet`; as `address` in `[web]`."""
    allowed_hosts: tuple[str, ...] = ()
    """Names, besides IP addresses and localhost, under which that page may be opened."""

    _full_address = field_validator("address")(page_address)

    def web(self) -> WebConfig:
        """The settings of the page of all fleets."""
        return WebConfig.model_validate(self.model_dump(include={"address", "allowed_hosts"}, exclude_unset=True))


def _host_and_port(address: str) -> tuple[str, int]:
    """Return the two parts of HOST:PORT, an IPv6 host without its brackets.

    Raises ValueError where the text is no such address.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isascii() or not port.isdigit() or not 1 <= int(port) <= 65535:
        raise ValueError(f"{address} is not HOST:PORT, as 192.168.1.12:14590")
    return host.removeprefix("[").removesuffix("]"), int(port)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False  # any other name may lead anywhere, also one that begins like an address


class StandbyConfig(Section):
    """`[standby]`: hot standby.

    A second service follows the same vehicles, and takes over where the first one fails.
    """

    peer: str = ""
    """HOST:PORT where the other service listens for our signs of life (UDP). Empty: there is no other service."""
    listen: str = "0.0.0.0:14590"
    """HOST:PORT where we listen for those of the other service."""
    role: Literal["active", "standby"] = "active"
    """What this service is from its start: `active` sends unless the other one does already, `standby` follows and takes over."""
    key_file: str = ""
    """File of the secret key of the two services, mode 0600, as that of `[signing]`. Without one a forged sign of life would
    silence a service, so that it may be left out on loopback alone."""

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if not self.peer:
            if self.key_file or self.role == "standby":
                raise ValueError('peer is not set: give the other service\'s address, as peer = "192.168.1.12:14590"')
            return self
        hosts = [_host_and_port(address)[0] for address in (self.peer, self.listen)]
        if not self.key_file and not all(map(_is_loopback, hosts)):
            raise ValueError(
                "key_file is not set, and beyond loopback anybody could silence this service; make a key for both services: "
                "(umask 077; openssl rand -hex 32 > standby.key)"
            )
        return self

    def peer_address(self) -> tuple[str, int]:
        """Where the other service listens, host and port."""
        return _host_and_port(self.peer)

    def listen_address(self) -> tuple[str, int]:
        """Where we listen, host and port."""
        return _host_and_port(self.listen)


class RecordConfig(Section):
    """`[record]`: recording the flight."""

    directory: str = ""
    """Where recordings are written. Empty: none are. `--record DIR` sets it."""
    rotate_mb: int = Field(500, ge=1, le=100_000)
    """A new pair of files begins at this size, megabytes."""
    keep_gb: float = Field(0.0, ge=0.0, le=1e6)
    """The recordings in the directory may be so large together, gigabytes; the oldest are deleted, never one that is being
    written. 0: all are kept."""

    @model_validator(mode="after")
    def _room_for_one(self) -> RecordConfig:
        if 0.0 < self.keep_gb * 1000.0 < self.rotate_mb:
            raise ValueError(f"keep_gb = {self.keep_gb:g} has no room for one pair of files of rotate_mb = {self.rotate_mb}")
        return self


def topic_level(text: str) -> str:
    """The text, if it can be one level of an MQTT topic. Raises ValueError where it cannot."""
    if not text or not all(c.isascii() and (c.isalnum() or c in "-_.") for c in text):
        raise ValueError(f"{text!r} is no part of a topic: letters, digits, -, _ and . only")
    return text


class MqttConfig(Section):
    """`[mqtt]`: the fleet on an MQTT broker. Off while no host is set."""

    host: str = ""
    """The broker's name or address. Empty: no MQTT."""
    port: int = Field(1883, ge=1, le=65535)
    """The broker's port; 8883 is usual with TLS (IANA: secure-mqtt), 1883 without."""
    tls: bool = False
    """Encrypt, and check the broker's certificate and name."""
    ca_file: str = ""
    """Certificates (PEM) to check the broker's by. Empty: the system's."""
    username: str = ""
    """The user. Empty: none."""
    password_file: str = ""
    """The file whose only line is the user's password."""
    prefix: str = "gcs-coloc"
    """The beginning of every topic: letters, digits, `-`, `_`, `.`."""
    fleet: str = "fleet"
    """This fleet's name in the topics; two services on one broker need two names."""
    publish_hz: float = Field(1.0, gt=0, le=5)
    """Each topic is published at most this often."""
    commands: bool = False
    """Accept operator commands from the `cmd` topics."""
    ranges: bool = False
    """Accept ranges from the `range` topics."""

    _topic_levels = field_validator("prefix", "fleet")(topic_level)

    @model_validator(mode="after")
    def _user_and_password_agree(self) -> Self:
        if self.password_file and not self.username:
            raise ValueError("a password_file is set, but no username")
        if self.ca_file and not self.tls:
            raise ValueError("a ca_file is set, but tls is false: nothing would be encrypted")
        if not self.host and (self.commands or self.ranges):
            raise ValueError("commands or ranges are to be taken, but no host is set: there is no broker to take them from")
        return self
