"""The page's server: its socket, its token, its beginning and its end.

Its failure never ends a flight.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import signal
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any, ClassVar

import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

from gcs_coloc.config.service_sections import WebConfig
from gcs_coloc.core.errors import ConfigError, WebError
from gcs_coloc.runtime.process import read_private_file
from gcs_coloc.web.app import WebHooks, make_app
from gcs_coloc.web.fleets_page import FleetsSource, make_fleets_app
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.playback import Playback
from gcs_coloc.web.tiles import TileFile

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


log = logging.getLogger("gcs_coloc")

_MIN_TOKEN_LENGTH = 16  # chosen: as random letters and digits 95 bits, which nobody guesses through a network
_MAX_CONNECTIONS = 128  # chosen: four times the most pages
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""The signals that uvicorn takes over while it serves."""


class WebServer:
    """The page, its commands and the metrics on one address."""

    def __init__(
        self,
        config: WebConfig,
        hooks: WebHooks | Playback | FleetsSource,
        pages: Pages,
        follow: Callable[[], Coroutine[Any, Any, None]] | None = None,
        *,
        must_serve: bool = False,
    ) -> None:
        """Read the token and prepare everything but the socket. `follow` runs while the page is served.

        `must_serve` where the program is of no use without its page.

        Raises:
            ConfigError: the token file or the file of tiles cannot be read, or its content is wrong.
        """
        self._config = config
        self._must_serve = must_serve
        self._failure: str | None = None
        self._stopping = asyncio.Event()
        self._background = [pages.run] + ([follow] if follow is not None else [])
        self._token = read_token(Path(config.token_file)) if config.token_file else None
        tiles = TileFile(Path(config.tiles)) if config.tiles else None
        if isinstance(hooks, FleetsSource):
            app = make_fleets_app(hooks, pages, config.allowed_hosts, self._lifespan)
        else:
            app = make_app(hooks, pages, self._token, tiles, config.allowed_hosts, self._lifespan)
        # uvicorn looks ten times a second whether it is to end, which costs as much as pictures for five pages. It awaits
        # `callback_notify` at the first look, and goes on once that has returned.
        self._server = uvicorn.Server(
            uvicorn.Config(
                app,
                http=RequestDeadline,
                ws_max_size=1024,
                ws_per_message_deflate=False,  # it would compress each picture once for every page
                lifespan="on",
                log_config=None,
                log_level="warning",
                access_log=False,
                server_header=False,
                date_header=False,  # uvicorn's is kept up to date by the ticks that are left out; `Guard` adds one
                callback_notify=self._wait_for_end,
                proxy_headers=False,
                limit_concurrency=_MAX_CONNECTIONS,
                timeout_graceful_shutdown=1,
            )
        )
        self._socket: socket.socket | None = None
        self._handlers: dict[signal.Signals, Any] = {}

    @property
    def must_open(self) -> bool:
        """Whether the operator set this address, so that the service must not run without its page."""
        return self._config.must_open

    def open(self) -> str:
        """Bind and listen; return the page's URL.

        Raises:
            WebError: the address is in use or cannot be listened on.
        """
        host, port = self._config.host_and_port()
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind(where)
            self._socket.listen(64)
        except OSError as error:
            self.close()
            if error.errno == errno.EADDRINUSE:
                text = f"web page: {self._config.address} is in use; choose another with --web HOST:PORT"
            else:
                text = f"web page: cannot listen on {self._config.address}: {error.strerror}"
            raise WebError(text) from None
        self._handlers = {number: signal.getsignal(number) for number in _SIGNALS}
        bound_host, bound_port = self._socket.getsockname()[:2]
        if self._token is not None and not bound_host.startswith("127.") and bound_host != "::1":
            log.warning("web page: the operator's token crosses the network unencrypted; use a tunnel or a TLS proxy")
        return f"http://{f'[{bound_host}]' if ':' in bound_host else bound_host}:{bound_port}/"

    async def run(self) -> None:
        """Serve until `stop`; a fault in here is logged and the flight goes on without the page.

        Raises:
            WebError: there was a fault, and the program must serve.
        """
        assert self._socket is not None
        background = [asyncio.create_task(run()) for run in self._background]
        for task in background:
            task.add_done_callback(self._note_end)
        try:
            await self._server.serve(sockets=[self._socket])
        except Exception as error:
            self._fail("ended", error)
        finally:
            for task in background:
                task.cancel()
            self._restore_signal_handlers()
            self.close()
        if self._failure is not None:
            raise WebError(self._failure)

    def _note_end(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._fail("stands still", error)

    def _fail(self, how: str, error: BaseException) -> None:
        text = f"web page: {how}: {type(error).__name__}: {error}"
        if self._must_serve:
            self._failure = f"{text}; start the program again"
            self.stop()
        else:
            log.error("%s; the flight goes on without it", text)

    def stop(self) -> None:
        """End the server: it closes the open pages and waits for them one second at most."""
        self._server.should_exit = True
        self._stopping.set()

    async def _wait_for_end(self) -> None:
        await self._stopping.wait()

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        del app
        self._restore_signal_handlers()
        yield

    def _restore_signal_handlers(self) -> None:
        """Give the signals back to the service, which has last messages to send.

        uvicorn takes them as it starts to serve.
        """
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()


def read_token(file: Path) -> str:
    """The operator's token: the only line of a file.

    Raises:
        ConfigError: the file cannot be read, is open to others than its owner, or holds fewer than 16 or other than printable
            ASCII characters.
    """
    try:
        token = read_private_file(file, "the operator's token", "web.token_file").decode("ascii").strip()
    except UnicodeDecodeError:
        token = ""
    if len(token) < _MIN_TOKEN_LENGTH or not all("!" <= c <= "~" for c in token):
        raise ConfigError(f"web.token_file: {file}: must hold one token of at least {_MIN_TOKEN_LENGTH} printable characters")
    return token
