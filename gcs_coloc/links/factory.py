"""From a parsed connection string to the link that it asks for."""

from __future__ import annotations

from gcs_coloc.links.address import LinkAddress, SerialPort, TcpClient, TcpServer
from gcs_coloc.links.base import Clock, DatagramHandler, Link
from gcs_coloc.links.serial import SerialLink
from gcs_coloc.links.tcp import TcpClientLink, TcpServerLink
from gcs_coloc.links.udp import UdpLink


def make_link(address: LinkAddress, handler: DatagramHandler, clock: Clock) -> Link:
    """Make the link of `address`; it is not open yet."""
    if isinstance(address, SerialPort):
        return SerialLink(address, handler, clock)
    if isinstance(address, TcpClient):
        return TcpClientLink(address, handler, clock)
    if isinstance(address, TcpServer):
        return TcpServerLink(address, handler, clock)
    return UdpLink(address, handler, clock)
