"""The ASGI app of the page: its files and WebSocket, operator's commands, metrics, health."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from gcs_coloc import __version__
from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, Override, PrimaryOverride
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.core.standby.sign_of_life import StandbyOrder
from gcs_coloc.sinks.metrics import fleet_registry
from gcs_coloc.web.access import Guard, bears_token
from gcs_coloc.web.pages import Pages, serve_live
from gcs_coloc.web.playback import Playback
from gcs_coloc.web.tiles import TileFile
from gcs_coloc.web.wire import Hello, PlaybackCommand

STATIC = Path(__file__).parent / "static"
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


class GpsCommand(BaseModel):
    """The body of an override of a vehicle's GPS state."""

    model_config = ConfigDict(extra="forbid")
    override: GpsOverride


class AidingCommand(BaseModel):
    """The body of an override of a vehicle's aiding."""

    model_config = ConfigDict(extra="forbid")
    override: AidingOverride


class PrimaryCommand(BaseModel):
    """The body of an override of a vehicle's GPS_PRIMARY."""

    model_config = ConfigDict(extra="forbid")
    override: PrimaryOverride


class OrderCommand(BaseModel):
    """The body of an order on the hot standby."""

    model_config = ConfigDict(extra="forbid")
    order: StandbyOrder


_COMMANDS: Mapping[str, type[GpsCommand | AidingCommand | PrimaryCommand]] = {
    "gps": GpsCommand,
    "aiding": AidingCommand,
    "gps_primary": PrimaryCommand,
}


class _Site:
    """The handlers and what they share."""

    def __init__(
        self, hooks: WebHooks | None, playback: Playback | None, pages: Pages, token: str | None, tiles: TileFile | None
    ) -> None:
        self._hooks = hooks
        self._playback = playback
        self._pages = pages
        self._token = token
        self._tiles = tiles
        self._registry: CollectorRegistry | None = fleet_registry(hooks.snapshot) if hooks is not None else None

    async def index(self, request: Request) -> Response:
        """The page."""
        del request
        return FileResponse(STATIC / "index.html")

    async def live(self, socket: WebSocket) -> None:
        """The page's WebSocket."""
        await serve_live(socket, self._pages, self._hello)

    async def command(self, request: Request) -> Response:
        """An operator override on one vehicle."""
        assert self._hooks is not None
        if not bears_token(request.headers, self._token):
            return PlainTextResponse("commands need the operator's token\n", status_code=403)
        sysid, model = request.path_params["sysid"], _COMMANDS.get(request.path_params["what"])
        if model is None:
            return PlainTextResponse(f"there are commands for {', '.join(_COMMANDS)}\n", status_code=404)
        if sysid not in {v.sysid for v in self._hooks.snapshot().vehicles}:
            return PlainTextResponse(f"no vehicle {sysid} was heard\n", status_code=404)
        refusal = self._hooks.command_refusal()
        if refusal is not None:
            return PlainTextResponse(f"{refusal}\n", status_code=409)
        body = await _body(request)
        if body is None:
            return PlainTextResponse("too long\n", status_code=413)
        try:
            command = model.model_validate_json(body)
        except ValidationError:
            values = ", ".join(f'"{value.value}"' for value in model.model_fields["override"].annotation or ())
            return PlainTextResponse(f'expected {{"override": VALUE}}, VALUE one of {values}\n', status_code=422)
        self._hooks.apply_command(sysid, command.override)
        return JSONResponse({"sysid": sysid, "override": command.override.value})

    async def order(self, request: Request) -> Response:
        """An operator's order on the hot standby."""
        assert self._hooks is not None
        if not bears_token(request.headers, self._token):
            return PlainTextResponse("orders need the operator's token\n", status_code=403)
        if self._hooks.order_standby is None:
            return PlainTextResponse("there is no hot standby: [standby] peer is not set\n", status_code=404)
        body = await _body(request)
        if body is None:
            return PlainTextResponse("too long\n", status_code=413)
        try:
            order = OrderCommand.model_validate_json(body).order
        except ValidationError:
            values = ", ".join(f'"{value.value}"' for value in StandbyOrder)
            return PlainTextResponse(f'expected {{"order": VALUE}}, VALUE one of {values}\n', status_code=422)
        refusal = self._hooks.order_standby(order)
        if refusal is not None:
            return PlainTextResponse(f"{refusal}\n", status_code=409)
        return JSONResponse({"order": order.value})

    async def acknowledge(self, request: Request) -> Response:
        """Acknowledge an alarm.

        It needs no token: it reaches no aircraft, and an alarm whose condition holds stays in the list.
        """
        assert self._hooks is not None
        alarm_id = request.path_params["alarm_id"]
        if not self._hooks.acknowledge(alarm_id):
            return PlainTextResponse(f"no alarm {alarm_id} waits to be acknowledged\n", status_code=404)
        return JSONResponse({"id": alarm_id})

    async def play(self, request: Request) -> Response:
        """Play, pause, seek or change the speed of a replay; answer with its state.

        It needs no token: a replay reaches no aircraft.
        """
        assert self._playback is not None
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
        self._playback.apply_command(command)
        return Response(self._playback.state.model_dump_json(), media_type="application/json")

    def tile(self, request: Request) -> Response:
        """One tile of the map; 204 where there is none.

        It is no coroutine, because it reads a file: it runs in a thread.
        """
        assert self._tiles is not None
        data = self._tiles.tile(*(request.path_params[key] for key in ("zoom", "x", "y")))
        if data is None:
            return Response(status_code=204)
        return Response(data, media_type=self._tiles.media_type, headers={"cache-control": "private, max-age=3600"})

    async def metrics(self, request: Request) -> Response:
        """The metrics for Prometheus."""
        del request
        assert self._registry is not None
        return Response(generate_latest(self._registry), headers={"content-type": CONTENT_TYPE_LATEST})

    async def healthy(self, request: Request) -> Response:
        """Whether the process answers at all."""
        del request
        return PlainTextResponse("ok\n")

    async def ready(self, request: Request) -> Response:
        """Whether the service does its work."""
        del request
        fault = self._hooks.fault() if self._hooks is not None else None
        return PlainTextResponse("ok\n") if fault is None else PlainTextResponse(f"{fault}\n", status_code=503)

    def _hello(self) -> str:
        source = self._pages.source
        return Hello(
            instance=source.instance,
            version=__version__,
            commands=self._token is not None and self._hooks is not None,
            replay=self._playback is not None,
            tiles=self._tiles.info if self._tiles is not None else None,
            utc_minus_service_s=source.utc_minus_service_s,
            history=source.tracks(),
        ).model_dump_json()


async def _body(request: Request) -> bytes | None:
    """The body of a command, None where it is too long for one."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _MAX_BODY_BYTES:
            return None
    return body


def make_app(
    source: WebHooks | Playback,
    pages: Pages,
    token: str | None,
    tiles: TileFile | None,
    allowed_hosts: Collection[str],
    lifespan: Callable[[Starlette], AbstractAsyncContextManager[None]],
) -> Starlette:
    """Make the application of a live service or a replay.

    `token` None makes it read-only. `tiles` None leaves the map without tiles.
    """
    if isinstance(source, Playback):
        site = _Site(None, source, pages, token, tiles)
        own = [Route("/api/playback", site.play, methods=["POST"])]
    else:
        site = _Site(source, None, pages, token, tiles)
        own = [
            Route("/api/vehicles/{sysid:int}/{what}", site.command, methods=["POST"]),
            Route("/api/alarms/{alarm_id:int}/acknowledge", site.acknowledge, methods=["POST"]),
            Route("/api/standby", site.order, methods=["POST"]),
            Route("/metrics", site.metrics),
        ]
    return Starlette(
        routes=[
            Route("/", site.index),
            Route("/healthz", site.healthy),
            Route("/readyz", site.ready),
            *own,
            *([Route("/tiles/{zoom:int}/{x:int}/{y:int}", site.tile)] if tiles is not None else []),
            WebSocketRoute("/live", site.live),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, allowed_hosts=allowed_hosts)],
        lifespan=lifespan,
    )
