"""The routes: the page and its files, one WebSocket, the operator's commands, metrics and health."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from gcs_coloc import __version__
from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, Override, PrimaryOverride
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.mavlink.truth import HeardTruth
from gcs_coloc.sinks.idle_scheduler import IdleScheduler
from gcs_coloc.sinks.metrics import fleet_registry
from gcs_coloc.web.access import Guard, bears_token
from gcs_coloc.web.live_socket import send_frame_of
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.playback import Playback
from gcs_coloc.web.tiles import TileFile
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import HIDDEN, Hello, PlaybackCommand

_STATIC = Path(__file__).parent / "static"
_MOST_BODY_BYTES = 1000


@dataclass(frozen=True, slots=True)
class Hooks:
    """What the server may ask of the service: the fleet as it stands, the operator's word, and whether it still works.

    `glance` is `look` without what is counted, for many times a second. `fault` says in words what keeps the service from its
    work, None where nothing does. `truths` is where a simulation says that vehicles truly are. `playback` is a replay's, which
    takes no word. In `idle` the pages' pictures are made and sent, `pictures_every_s` apart.
    """

    look: Callable[[], FleetSnapshot]
    glance: Callable[[], FleetSnapshot]
    obey: Callable[[int, Override], None] | None
    fault: Callable[[], str | None]
    truths: Callable[[], Iterable[HeardTruth]] = tuple
    playback: Playback | None = None
    idle: IdleScheduler = field(default_factory=IdleScheduler)
    pictures_every_s: float = 0.2


class GpsCommand(BaseModel):
    """The body of a command on a vehicle's GPS."""

    model_config = ConfigDict(extra="forbid")
    word: GpsOverride


class AidCommand(BaseModel):
    """The body of a command on a vehicle's aid."""

    model_config = ConfigDict(extra="forbid")
    word: AidingOverride


class PrimaryCommand(BaseModel):
    """The body of a command on a vehicle's GPS_PRIMARY."""

    model_config = ConfigDict(extra="forbid")
    word: PrimaryOverride


_COMMANDS: Mapping[str, type[GpsCommand | AidCommand | PrimaryCommand]] = {
    "gps": GpsCommand,
    "aid": AidCommand,
    "primary": PrimaryCommand,
}


class _Site:
    """The handlers and what they share."""

    def __init__(self, hooks: Hooks, story: TrackHistory, pages: Pages, token: str | None, tiles: TileFile | None) -> None:
        self._hooks = hooks
        self._story = story
        self._pages = pages
        self._token = token
        self._tiles = tiles
        self._registry: CollectorRegistry = fleet_registry(hooks.look)

    async def index(self, request: Request) -> Response:
        """The page."""
        del request
        return FileResponse(_STATIC / "index.html")

    async def live(self, socket: WebSocket) -> None:
        """The page's WebSocket: hello, then events and pictures until it is closed. The page says whether it is looked at."""
        if self._pages.full:
            await socket.close(1013, "too many pages are open")
            return
        page = self._pages.add(send_frame_of(socket.scope))
        sender: asyncio.Task[None] | None = None
        try:
            await socket.accept()
            sender = asyncio.create_task(page.send_all(self._story, self._hello, socket.send_text))
            while (message := await socket.receive())["type"] != "websocket.disconnect":
                page.show(message.get("text") != HIDDEN)
        except WebSocketDisconnect:
            pass
        finally:
            self._pages.remove(page)
            if sender is not None:
                sender.cancel()
                await asyncio.gather(sender, return_exceptions=True)

    async def command(self, request: Request) -> Response:
        """The operator's word on one vehicle."""
        if not bears_token(request.headers, self._token):
            return PlainTextResponse("commands need the operator's token\n", status_code=403)
        sysid, model = request.path_params["sysid"], _COMMANDS.get(request.path_params["what"])
        if model is None:
            return PlainTextResponse(f"there are commands for {', '.join(_COMMANDS)}\n", status_code=404)
        if sysid not in {v.sysid for v in self._hooks.look().vehicles}:
            return PlainTextResponse(f"no vehicle {sysid} was heard\n", status_code=404)
        body = await _body(request)
        if body is None:
            return PlainTextResponse("too long\n", status_code=413)
        try:
            command = model.model_validate_json(body)
        except ValidationError:
            words = ", ".join(f'"{word.value}"' for word in model.model_fields["word"].annotation or ())
            return PlainTextResponse(f'expected {{"word": WORD}}, WORD one of {words}\n', status_code=422)
        assert self._hooks.obey is not None
        self._hooks.obey(sysid, command.word)
        return JSONResponse({"sysid": sysid, "word": command.word.value})

    async def play(self, request: Request) -> Response:
        """Play, pause, seek, speed of a replay; answers with its state. No token: nothing that it does reaches an aircraft."""
        body = await _body(request)
        if body is None:
            return PlainTextResponse("too long\n", status_code=413)
        try:
            command = PlaybackCommand.model_validate_json(body)
        except ValidationError as error:
            wrong = "; ".join(f"{'.'.join(str(part) for part in e['loc'])}: {e['msg']}" for e in error.errors())
            text = (
                f'expected {{"playing": true or false, "speed": NUMBER or "max", "seek_s": UNIX seconds, "halt": true}}, '
                f"any of them: {wrong}\n"
            )
            return PlainTextResponse(text, status_code=422)
        assert self._hooks.playback is not None
        self._hooks.playback.obey(command)
        return Response(self._hooks.playback.state.model_dump_json(), media_type="application/json")

    def tile(self, request: Request) -> Response:
        """One tile of the map; 204 where there is none. No coroutine, for it reads a file: it runs in a thread."""
        assert self._tiles is not None
        data = self._tiles.tile(*(request.path_params[key] for key in ("zoom", "x", "y")))
        if data is None:
            return Response(status_code=204)
        return Response(data, media_type=self._tiles.media_type, headers={"cache-control": "private, max-age=3600"})

    async def metrics(self, request: Request) -> Response:
        """The metrics for Prometheus."""
        del request
        return Response(generate_latest(self._registry), headers={"content-type": CONTENT_TYPE_LATEST})

    async def healthy(self, request: Request) -> Response:
        """Whether the process answers at all."""
        del request
        return PlainTextResponse("ok\n")

    async def ready(self, request: Request) -> Response:
        """Whether the service does its work."""
        del request
        fault = self._hooks.fault()
        return PlainTextResponse("ok\n") if fault is None else PlainTextResponse(f"{fault}\n", status_code=503)

    def _hello(self) -> str:
        return Hello(
            instance=self._story.instance,
            version=__version__,
            commands=self._token is not None and self._hooks.obey is not None,
            replay=self._hooks.playback is not None,
            tiles=self._tiles.info if self._tiles is not None else None,
            utc_minus_service_s=self._hooks.look().utc_minus_service_s,
            history=self._story.history(),
        ).model_dump_json()


async def _body(request: Request) -> bytes | None:
    """The body of a command, None where it is too long for one."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _MOST_BODY_BYTES:
            return None
    return body


def make_app(
    hooks: Hooks, story: TrackHistory, pages: Pages, token: str | None, tiles: TileFile | None, allowed_hosts: Collection[str]
) -> Starlette:
    """The application; `token` None makes it read-only, `tiles` None leaves the map without."""
    site = _Site(hooks, story, pages, token, tiles)
    if hooks.playback is None:
        commands = Route("/api/vehicles/{sysid:int}/{what}", site.command, methods=["POST"])
    else:
        commands = Route("/api/playback", site.play, methods=["POST"])
    return Starlette(
        routes=[
            Route("/", site.index),
            Route("/metrics", site.metrics),
            Route("/healthz", site.healthy),
            Route("/readyz", site.ready),
            commands,
            *([Route("/tiles/{zoom:int}/{x:int}/{y:int}", site.tile)] if tiles is not None else []),
            WebSocketRoute("/live", site.live),
            Mount("/static", StaticFiles(directory=_STATIC)),
        ],
        middleware=[Middleware(Guard, allowed_hosts=allowed_hosts)],
    )
