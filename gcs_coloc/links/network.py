"""What UDP and TCP links share: telling in words why a host or port cannot be used."""

from __future__ import annotations

import errno
import os
import socket

from gcs_coloc.core.errors import LinkError
from gcs_coloc.links.address import TcpClient, TcpServer, UdpIn, UdpOut


def reason(error: OSError) -> str:
    """The system's words for an error: asyncio puts its own, and the address once more, in their place."""
    return os.strerror(error.errno) if error.errno is not None and error.errno > 0 else error.strerror or str(error)


def network_error(address: UdpIn | UdpOut | TcpClient | TcpServer, error: OSError) -> LinkError:
    """Make the error, in words for the operator, of a host that cannot be resolved or a port that cannot be bound."""
    if isinstance(error, socket.gaierror):
        return LinkError(f"{address}: host {address.host!r} is not found ({error.strerror})")
    if error.errno == errno.EADDRINUSE:
        return LinkError(
            f"{address}: port {address.port} is in use by another program (QGroundControl and MAVProxy listen on 14550 too); "
            "stop it, or have it forward to another port and listen there; or start gcs-coloc first, with --out "
            "udp:127.0.0.1:14551, and have that program listen on 14551"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return LinkError(f"{address}: {address.host} is no address of this machine; use 0.0.0.0 to listen on all of them")
    if error.errno == errno.EACCES:
        return LinkError(f"{address}: no permission to listen on port {address.port}; take one above 1023")
    if error.errno == errno.EINVAL and address.host.lower().startswith("fe80:") and "%" not in address.host:
        return LinkError(f"{address}: a link-local address needs its interface, as [{address.host}%eth0]")
    return LinkError(f"{address}: cannot be opened: {reason(error)}")
