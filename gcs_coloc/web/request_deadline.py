"""The deadline of a connection's request: it is closed where the request is not answered in time.

No host can hold all connections by requests that it does not finish.
uvicorn has a limit of connections and none of the time that a request takes to arrive. This stands before its protocol: until
the connection is closed, as it is with the answer (see `Guard`), or is a WebSocket's, it is half-open.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

ANSWERED_WITHIN_S = 60.0
"""Chosen: the largest file of the page, 150 kB, over a radio link of 25 kbit/s."""
MAX_HALF_OPEN = 32
"""Half-open connections of one host. Chosen: a browser opens six at once; a quarter of the page's limit of connections."""


class RequestDeadline(asyncio.Protocol):
    """Passes one connection on to uvicorn's protocol, and closes it where its request is not answered."""

    _half_open: ClassVar[Counter[Any]] = Counter()

    def __init__(self, **uvicorn_state: Any) -> None:
        self._inner = H11Protocol(**uvicorn_state)
        self._transport: asyncio.Transport
        self._host: Any = None
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the deadline; a host with too many half-open connections gets no more."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._inner.connection_made(transport)
        self._host = (transport.get_extra_info("peername") or ("",))[0]
        self._half_open[self._host] += 1
        if self._half_open[self._host] > MAX_HALF_OPEN:
            transport.abort()
        self._timer = asyncio.get_running_loop().call_later(ANSWERED_WITHIN_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        """Pass the bytes on; the deadline ends where they make the connection a WebSocket's."""
        self._inner.data_received(data)
        if self._transport.get_protocol() is not self:
            self._end_deadline()

    def eof_received(self) -> bool | None:
        """Pass it on."""
        return self._inner.eof_received()  # type: ignore[func-returns-value]

    def pause_writing(self) -> None:
        """Pass it on."""
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        """Pass it on."""
        self._inner.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass it on."""
        self._end_deadline()
        self._inner.connection_lost(exc)

    def _end_deadline(self) -> None:
        if self._timer is None:
            return
        self._timer.cancel()
        self._timer = None
        self._half_open[self._host] -= 1
        if self._half_open[self._host] <= 0:
            del self._half_open[self._host]
