"""Connection strings, in the forms that MAVProxy and its kin have made customary."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

from gcs_coloc.core.errors import UsageError

DEFAULT_BIND_HOST = "0.0.0.0"  # noqa: S104 - vehicles are on the network, listening there is the purpose
DEFAULT_BAUD = 57600

FORMS = (
    "14550, HOST:PORT, udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or serial:/dev/ttyUSB0:57600 "
    "(an IPv6 address in brackets: udpin:[::]:14550)"
)

OUT_FORMS = (
    "HOST:PORT or udp:HOST:PORT (sent to that address), udpin:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or "
    "serial:/dev/ttyUSB0:57600 (an IPv6 address in brackets: udp:[::1]:14551)"
)


@dataclass(frozen=True, slots=True)
class UdpIn:
    """Listen for datagrams; answers go to the address each vehicle was heard from."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"udpin:{_host_port(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class UdpOut:
    """Send the first datagram to a known address, from a port that the system chooses."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"udpout:{_host_port(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class TcpClient:
    """Connect to a listening TCP port, again and again when the connection is lost."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tcp:{_host_port(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class TcpServer:
    """Accept TCP connections."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"tcpin:{_host_port(self.host, self.port)}"


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial device, such as a telemetry radio."""

    device: str
    baud: int

    def __str__(self) -> str:
        return f"serial:{self.device}:{self.baud}"


LinkAddress = UdpIn | UdpOut | TcpClient | TcpServer | SerialPort

_NETWORK_KINDS: dict[str, type[UdpIn | UdpOut | TcpClient | TcpServer]] = {
    "udpin": UdpIn,
    "udpout": UdpOut,
    "tcp": TcpClient,
    "tcpin": TcpServer,
}
_LISTENING = (UdpIn, TcpServer)
_HOST_PORT = re.compile(r"(?:\[(?P<ipv6>[0-9A-Fa-f:.]+(?:%[\w.-]+)?)\]|(?P<host>[^\[\]:/\s]+)):(?P<port>[0-9]{1,5})", re.ASCII)
_PORT = re.compile(r"[0-9]{1,5}", re.ASCII)
_DEVICE = re.compile(r"(?P<device>/[^,\s]*?)(?:[:,](?P<baud>[0-9]{1,8}))?", re.ASCII)


def opened(address: LinkAddress) -> str:
    """What a link does once it is open, in words for the operator."""
    match address:
        case TcpClient():
            return f"connecting to {address}"
        case UdpOut():
            return f"sending to {address}"
        case _:
            return f"listening on {address}"


class _MalformedError(Exception):
    """A text that is in no form of a connection string."""


def parse(text: str) -> LinkAddress:
    """Read a connection string. Raises UsageError that quotes it and shows the right forms."""
    return _parse(text, UdpIn, FORMS)


def parse_out(text: str) -> LinkAddress:
    """Read a ground tool's connection string: as `parse`, but `udp:` and a bare HOST:PORT are sent to, as MAVProxy's."""
    return _parse(text, UdpOut, OUT_FORMS)


def parse_links(texts: Iterable[str]) -> list[LinkAddress]:
    """Read the connection strings of the vehicles' links. Raises UsageError where one is malformed, or two are the same place."""
    links = [parse(text) for text in texts]
    for one, other in combinations(links, 2):
        if _same_place(one, other):
            both = f"{one} is given twice" if one == other else f"{one} and {other} are the same place"
            raise UsageError(f"{both}; leave one out")
    return links


def _same_place(one: LinkAddress, other: LinkAddress) -> bool:
    if isinstance(one, SerialPort) or isinstance(other, SerialPort):
        return isinstance(one, SerialPort) and isinstance(other, SerialPort) and one.device == other.device
    if type(one) is not type(other) or one.port != other.port:
        return False
    hosts = {one.host, other.host}
    return len(hosts) == 1 or (isinstance(one, _LISTENING) and DEFAULT_BIND_HOST in hosts and not any(":" in h for h in hosts))


def _parse(text: str, plain_udp: type[UdpIn | UdpOut], forms: str) -> LinkAddress:
    stripped = text.strip()
    kind, colon, rest = stripped.partition(":")
    try:
        if stripped.startswith("/"):
            return _serial(stripped, text)
        if colon and kind == "serial":
            return _serial(rest, text)
        if colon and kind in _NETWORK_KINDS:
            return _network(_NETWORK_KINDS[kind], rest, text)
        return _network(plain_udp, rest if colon and kind == "udp" else stripped, text)
    except _MalformedError:
        raise UsageError(f"{text!r} is no connection string; write {forms}") from None


def _network(kind: type[UdpIn | UdpOut | TcpClient | TcpServer], place: str, text: str) -> LinkAddress:
    if kind in _LISTENING and _PORT.fullmatch(place):
        return kind(DEFAULT_BIND_HOST, _port(place, text))
    matched = _HOST_PORT.fullmatch(place)
    if matched is None:
        raise _MalformedError
    host = matched["ipv6"] or matched["host"]
    try:
        host.encode("idna")
    except UnicodeError:
        raise _MalformedError from None
    return kind(host, _port(matched["port"], text))


def _port(digits: str, text: str) -> int:
    port = int(digits)
    if not 1 <= port <= 65535:
        raise UsageError(f"{text!r}: port {port} does not exist, ports are 1 to 65535")
    return port


def _serial(place: str, text: str) -> SerialPort:
    matched = _DEVICE.fullmatch(place)
    if matched is None:
        raise _MalformedError
    baud = int(matched["baud"]) if matched["baud"] else DEFAULT_BAUD
    if baud == 0:
        raise UsageError(f"{text!r}: a serial device cannot run at 0 baud")
    return SerialPort(matched["device"], baud)


def _host_port(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
