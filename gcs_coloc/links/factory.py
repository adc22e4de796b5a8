"""From a parsed connection string to the link that it asks for."""

from __future__ import annotations

from gcs_coloc.links.address import LinkAddress, SerialPort, TcpClient, TcpServer
from gcs_coloc.links.base import Clock, DatagramHandler, Link
from gcs_coloc.links.serial import SerialLink
from gcs_coloc.links.stream import MAX_UNSENT_BYTES
from gcs_coloc.links.tcp import TcpClientLink, TcpServerLink
from gcs_coloc.links.udp import UdpLink


def make_link(address: LinkAddress, handler: DatagramHandler, clock: Clock, *, most_unsent_bytes: int = MAX_UNSENT_BYTES) -> Link:
    """Make the link of `address`; it is not open yet. What a stream is slow to take is kept up to `most_unsent_bytes`."""
    if isinstance(address, SerialPort):
        return SerialLink(address, handler, clock, most_unsent_bytes=most_unsent_bytes)
    if isinstance(address, TcpClient):
        return TcpClientLink(address, handler, clock, most_unsent_bytes=most_unsent_bytes)
    if isinstance(address, TcpServer):
        return TcpServerLink(address, handler, clock, most_unsent_bytes=most_unsent_bytes)
    return UdpLink(address, handler, clock)
