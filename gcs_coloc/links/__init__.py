"""Sockets and serial lines: datagrams with their address and arrival time, nothing more."""
