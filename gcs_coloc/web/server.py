"""The server inside the service: its socket, its token, its beginning and its end. Its failure never ends the flight."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
from collections.abc import Iterator
from pathlib import Path

import uvicorn

from gcs_coloc.config.sections import WebConfig
from gcs_coloc.core.errors import ConfigError, WebError
from gcs_coloc.sinks.event_bus import Subscription
from gcs_coloc.web.app import Hooks, make_app
from gcs_coloc.web.live_socket import LiveSocket
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.tiles import TileFile
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import fleet_json

log = logging.getLogger("gcs_coloc")

_SHORTEST_TOKEN = 16
_MOST_CONNECTIONS = 128
_MOST_UNSENT_BYTES = 16_384
"""What a page is slow to take waits here up to this, two or three pictures: the system would keep minutes of old ones for it."""


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._ending = asyncio.Event()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Signals are the service's: it has last words to send."""
        yield

    async def main_loop(self) -> None:
        """Wait for the end, and wake for nothing before it: uvicorn's own looks whether to end ten times a second."""
        await self.on_tick(0)
        await self._ending.wait()

    def end(self) -> None:
        """Take no more requests, and let `serve` return."""
        self.should_exit = True
        self._ending.set()


class WebServer:
    """The page, its commands and the metrics on one address."""

    def __init__(self, config: WebConfig, hooks: Hooks, story: TrackHistory, news: Subscription | None = None) -> None:
        """Read the token and prepare everything but the socket. `news` is what the story follows, unless somebody else fills it.

        Raises:
            ConfigError: the token file or the file of tiles cannot be read, or what is in it is none.
        """
        self._config = config
        self._story = story
        self._news = news
        self._pages = Pages(
            lambda: _picture(hooks),
            lambda: story.counts(hooks.look()).model_dump_json().encode(),
            story,
            hooks.idle,
            hooks.pictures_every_s,
        )
        self._token = read_token(Path(config.token_file)) if config.token_file else None
        tiles = TileFile(Path(config.tiles)) if config.tiles else None
        app = make_app(hooks, story, self._pages, self._token, tiles, config.allowed_hosts)
        self._server = _Server(
            uvicorn.Config(
                app,
                ws=LiveSocket,
                http="h11",
                ws_max_size=1024,
                ws_per_message_deflate=False,  # would compress each picture once for every page
                lifespan="off",
                log_config=None,
                log_level="warning",
                access_log=False,
                server_header=False,
                date_header=False,  # uvicorn's is kept up to date by its ticks; `Guard` adds one
                proxy_headers=False,
                limit_concurrency=_MOST_CONNECTIONS,
                timeout_graceful_shutdown=1,
            )
        )
        self._socket: socket.socket | None = None

    @property
    def must_open(self) -> bool:
        """Whether the operator asked for this very address."""
        return self._config.must_open

    def open(self) -> str:
        """Take the address; returns the page's URL.

        Raises:
            WebError: the address is in use or cannot be listened on.
        """
        host, port = self._config.host_and_port()
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # of Linux and macOS; connections inherit it
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _MOST_UNSENT_BYTES)
            self._socket.bind(where)
            self._socket.listen(64)
        except OSError as error:
            self.close()
            if error.errno == errno.EADDRINUSE:
                text = f"web page: {self._config.address} is in use; choose another with --web HOST:PORT"
            else:
                text = f"web page: cannot listen on {self._config.address}: {error.strerror}"
            raise WebError(text) from None
        bound_host, bound_port = self._socket.getsockname()[:2]
        if self._token is not None and not bound_host.startswith("127.") and bound_host != "::1":
            log.warning("web page: the operator's token crosses the network unencrypted; use a tunnel or a TLS proxy")
        return f"http://{f'[{bound_host}]' if ':' in bound_host else bound_host}:{bound_port}/"

    async def run(self) -> None:
        """Serve until `stop`; a fault in here is logged and the flight goes on without the page."""
        assert self._socket is not None
        background = [asyncio.create_task(self._pages.run())]
        if self._news is not None:
            background.append(asyncio.create_task(self._story.follow(self._news)))
        for task in background:
            task.add_done_callback(_tell_of_failure)
        try:
            await self._server.serve(sockets=[self._socket])
        except Exception as error:
            log.error("web page: ended: %s: %s; the flight goes on without it", type(error).__name__, error)
        finally:
            for task in background:
                task.cancel()
            self.close()

    def stop(self) -> None:
        """Ask the server to end; open pages are told, and are waited for one second at most."""
        self._server.end()

    def close(self) -> None:
        """Give the address back."""
        if self._socket is not None:
            self._socket.close()


def _tell_of_failure(task: asyncio.Task[None]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None:
        log.error("web page: stands still: %s: %s; the flight goes on without it", type(error).__name__, error)


def _picture(hooks: Hooks) -> bytes:
    playback = hooks.playback.state if hooks.playback is not None else None
    return fleet_json(fleet_frame(hooks.glance(), hooks.truths(), playback))


def read_token(file: Path) -> str:
    """The operator's token: the only line of a file.

    Raises:
        ConfigError: the file cannot be read, or holds fewer than 16 or other than printable ASCII characters.
    """
    try:
        token = file.read_text(encoding="ascii").strip()
    except OSError as error:
        raise ConfigError(f"web.token_file: {file}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        token = ""
    if len(token) < _SHORTEST_TOKEN or not all("!" <= c <= "~" for c in token):
        raise ConfigError(f"web.token_file: {file}: must hold one token of at least {_SHORTEST_TOKEN} printable characters")
    return token
