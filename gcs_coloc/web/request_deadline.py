"""The deadline of a connection's first request: it is closed where the header does not arrive.

No host can hold all connections by half-open ones.
uvicorn has a limit of connections and none of the time that a request takes to arrive. This stands before its protocol and
knows the bytes alone: until the first request's header is whole, the connection is half-open.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_WITHIN_S = 10.0
"""Chosen: a header is one or two packets; a slow radio link repeats them within seconds."""
MAX_HALF_OPEN = 16
"""Half-open connections of one host. Chosen: a browser opens six at once; far below the page's limit of connections."""
_HEADER_END = b"\r\n\r\n"


class RequestDeadline(asyncio.Protocol):
    """Passes one connection on to uvicorn's protocol, and closes it where the first request does not come."""

    _half_open: ClassVar[Counter[Any]] = Counter()

    def __init__(self, **uvicorn_state: Any) -> None:
        self._inner = H11Protocol(**uvicorn_state)
        self._end = b""
        self._host: Any = None
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the deadline; a host with too many half-open connections gets no more."""
        assert isinstance(transport, asyncio.Transport)
        self._inner.connection_made(transport)
        self._host = (transport.get_extra_info("peername") or ("",))[0]
        self._half_open[self._host] += 1
        if self._half_open[self._host] > MAX_HALF_OPEN:
            transport.abort()
        self._timer = asyncio.get_running_loop().call_later(HEADER_WITHIN_S, transport.abort)

    def data_received(self, data: bytes) -> None:
        """Pass the bytes on; the end of the first header ends the deadline."""
        if self._timer is not None:
            if _HEADER_END in self._end + data:
                self._arrived()
            self._end = (self._end + data)[-len(_HEADER_END) :]
        self._inner.data_received(data)

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
        self._arrived()
        self._inner.connection_lost(exc)

    def _arrived(self) -> None:
        if self._timer is None:
            return
        self._timer.cancel()
        self._timer = None
        self._half_open[self._host] -= 1
        if self._half_open[self._host] <= 0:
            del self._half_open[self._host]
