"""The ASGI app of the page: its files and WebSocket, operator's commands, metrics, health."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TypeVar

from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import TypeAdapter, ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from gcs_coloc import __version__
from gcs_coloc.core.messages.control import OVERRIDE_KINDS, Override
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.core.standby.sign_of_life import StandbyOrder
from gcs_coloc.sinks.metrics import fleet_registry
from gcs_coloc.web.access import Guard, bears_token
from gcs_coloc.web.pages import Pages, serve_live
from gcs_coloc.web.playback import Playback
from gcs_coloc.web.tiles import TileFile
from gcs_coloc.web.wire import Hello, PlaybackCommand

Choice = TypeVar("Choice", bound=Enum)
Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]

_STATIC = Path(__file__).parent / "static"
_MAX_BODY_BYTES = 1000  # chosen: ten times the longest command


@dataclass(frozen=True, slots=True)
class WebHooks:
    """What the server needs of the live service; a replay has none."""

    snapshot: Callable[[], FleetSnapshot]
    """The fleet with its counters, for the metrics."""
    apply_command: Callable[[int, Override], None]
    """Applies an operator override to a vehicle, by system id."""
    acknowledge: Callable[[int], bool]
    """Acknowledges an alarm, by its id; False where none of that id waits for it."""
    fault: Callable[[], str | None]
    """Says in words what keeps the service from its work; None where nothing does."""
    command_refusal: Callable[[], str | None] = lambda: None
    """Says why overrides are not to be given to this service; None where they may."""
    order_standby: Callable[[StandbyOrder], str | None] | None = None
    """Carries out an order on the hot standby, and says why not where it does not; None where there is none."""


class _LiveRoutes:
    """The requests of a live service. `token` None makes it read-only."""

    def __init__(self, hooks: WebHooks, token: str | None) -> None:
        self._hooks = hooks
        self._token = token
        self._registry = fleet_registry(hooks.snapshot)

    async def command(self, request: Request) -> Response:
        """An operator override on one vehicle."""
        if not bears_token(request.headers, self._token):
            raise _refused(403, "commands need the operator's token")
        sysid, kind = request.path_params["sysid"], OVERRIDE_KINDS.get(request.path_params["what"])
        if kind is None:
            raise _refused(404, f"there are commands for {', '.join(OVERRIDE_KINDS)}")
        if sysid not in {v.sysid for v in self._hooks.snapshot().vehicles}:
            raise _refused(404, f"no vehicle {sysid} was heard")
        refusal = self._hooks.command_refusal()
        if refusal is not None:
            raise _refused(409, refusal)
        override = await _chosen(request, "override", kind)
        self._hooks.apply_command(sysid, override)
        return JSONResponse({"sysid": sysid, "override": override.value})

    async def order(self, request: Request) -> Response:
        """An operator's order on the hot standby."""
        if not bears_token(request.headers, self._token):
            raise _refused(403, "orders need the operator's token")
        if self._hooks.order_standby is None:
            raise _refused(404, "there is no hot standby: [standby] peer is not set")
        order = await _chosen(request, "order", StandbyOrder)
        refusal = self._hooks.order_standby(order)
        if refusal is not None:
            raise _refused(409, refusal)
        return JSONResponse({"order": order.value})

    async def acknowledge(self, request: Request) -> Response:
        """Acknowledge an alarm.

        It needs no token: it reaches no aircraft, and an alarm whose condition holds stays in the list.
        """
        alarm_id = request.path_params["alarm_id"]
        if not self._hooks.acknowledge(alarm_id):
            raise _refused(404, f"no alarm {alarm_id} waits to be acknowledged")
        return JSONResponse({"id": alarm_id})

    async def metrics(self, _: Request) -> Response:
        """The metrics for Prometheus."""
        return Response(generate_latest(self._registry), headers={"content-type": CONTENT_TYPE_LATEST})


def _refused(status: int, text: str) -> HTTPException:
    return HTTPException(status, f"{text}\n")


async def _body(request: Request) -> bytes:
    """The body of a command; one that is too long is refused."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _MAX_BODY_BYTES:
            raise _refused(413, "too long")
    return body


async def _chosen(request: Request, key: str, kind: type[Choice]) -> Choice:
    """The one value in a body `{key: VALUE}`; another body is refused."""
    try:
        content: dict[str, Choice] = TypeAdapter(dict[str, kind]).validate_json(await _body(request))  # type: ignore[valid-type]
    except ValidationError:
        content = {}
    if content.keys() == {key}:
        return content[key]
    values = ", ".join(f'"{value.value}"' for value in kind)
    raise _refused(422, f'expected {{"{key}": VALUE}}, VALUE one of {values}')


async def _play(playback: Playback, request: Request) -> Response:
    """Play, pause, seek or change the speed of a replay; answer with its state.

    It needs no token: a replay reaches no aircraft.
    """
    try:
        command = PlaybackCommand.model_validate_json(await _body(request))
    except ValidationError as error:
        wrong = "; ".join(f"{'.'.join(str(part) for part in e['loc'])}: {e['msg']}" for e in error.errors())
        expected = '{"playing": true or false, "speed": NUMBER or "max", "seek_s": UNIX seconds, "halt": true}'
        raise _refused(422, f"expected {expected}, any of them: {wrong}") from None
    playback.apply_command(command)
    return Response(playback.state.model_dump_json(), media_type="application/json")


def _tile(tiles: TileFile, request: Request) -> Response:
    """One tile of the map; 204 where there is none.

    It is no coroutine, because it reads a file: it runs in a thread.
    """
    data = tiles.tile(*(request.path_params[key] for key in ("zoom", "x", "y")))
    if data is None:
        return Response(status_code=204)
    return Response(data, media_type=tiles.media_type, headers={"cache-control": "private, max-age=3600"})


def make_app(
    source: WebHooks | Playback,
    pages: Pages,
    token: str | None,
    tiles: TileFile | None,
    allowed_hosts: Collection[str],
    lifespan: Lifespan,
) -> Starlette:
    """Make the application of a live service or a replay.

    `token` None makes it read-only. `tiles` None leaves the map without tiles.
    """
    routes = [Route("/tiles/{zoom:int}/{x:int}/{y:int}", partial(_tile, tiles))] if tiles is not None else []
    if isinstance(source, Playback):
        routes.append(Route("/api/playback", partial(_play, source), methods=["POST"]))
    else:
        live = _LiveRoutes(source, token)
        routes += [
            Route("/api/vehicles/{sysid:int}/{what}", live.command, methods=["POST"]),
            Route("/api/alarms/{alarm_id:int}/acknowledge", live.acknowledge, methods=["POST"]),
            Route("/api/standby", live.order, methods=["POST"]),
            Route("/metrics", live.metrics),
        ]

    def hello() -> str:
        return Hello(
            instance=pages.source.instance,
            version=__version__,
            commands=token is not None and isinstance(source, WebHooks),
            replay=isinstance(source, Playback),
            tiles=tiles.info if tiles is not None else None,
            utc_minus_service_s=pages.source.utc_minus_service_s,
            history=pages.source.tracks(),
        ).model_dump_json()

    fault = source.fault if isinstance(source, WebHooks) else lambda: None
    return page_app("index.html", pages, hello, fault, routes, allowed_hosts, lifespan)


def page_app(
    file: str,
    pages: Pages,
    hello: Callable[[], str],
    fault: Callable[[], str | None],
    routes: Sequence[Route],
    allowed_hosts: Collection[str],
    lifespan: Lifespan,
) -> Starlette:
    """Make an application of one page: its file, its WebSocket, its health, and further routes.

    `hello` makes the first message to the page, `fault` says what keeps the service from its work.
    """

    async def index(_: Request) -> Response:
        return FileResponse(_STATIC / file)

    async def live(socket: WebSocket) -> None:
        await serve_live(socket, pages, hello)

    async def healthy(_: Request) -> Response:
        return PlainTextResponse("ok\n")

    async def ready(_: Request) -> Response:
        text = fault()
        if text is not None:
            raise _refused(503, text)
        return PlainTextResponse("ok\n")

    return Starlette(
        routes=[
            Route("/", index),
            Route("/healthz", healthy),
            Route("/readyz", ready),
            *routes,
            WebSocketRoute("/live", live),
            Mount("/static", StaticFiles(directory=_STATIC)),
        ],
        middleware=[Middleware(Guard, allowed_hosts=allowed_hosts)],
        lifespan=lifespan,
    )
