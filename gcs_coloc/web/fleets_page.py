"""The page of all fleets: the messages to it, and the application that serves it.

The page shows the fleets and has no commands.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractAsyncContextManager
from typing import Literal

from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import BaseModel, ConfigDict
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from gcs_coloc import __version__
from gcs_coloc.sinks.fleets_metrics import fleets_registry
from gcs_coloc.sinks.watched_fleets import FleetShown
from gcs_coloc.web.access import Guard
from gcs_coloc.web.app import STATIC
from gcs_coloc.web.pages import Pages, serve_live
from gcs_coloc.web.wire import EventsFrame, VehicleHistory

FLEETS_EVERY_S = 0.4
"""Pictures of all fleets. Chosen: with messages once a second what is shown is at most 1.5 s old."""


class FleetsFrame(BaseModel):
    """All fleets at one instant, the most serious first; a page that is slow gets only the latest.

    `origin` is where their states come from, in words, `problem` what keeps them from coming; None where nothing does.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    kind: Literal["fleets"] = "fleets"
    origin: str
    problem: str | None
    refused: dict[str, int]
    fleets: tuple[FleetShown, ...]


class FleetsHello(BaseModel):
    """The first message of the page of all fleets."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    kind: Literal["hello"] = "hello"
    instance: str
    version: str


class FleetsSource:
    """What the page of all fleets is sent; a `PageSource`.

    `shown` returns the fleets as they stand, `origin` says in words where their states come from, `problem` what keeps them from
    coming, `refused` how often what was not understood, by reason.
    """

    edition = 0
    newest_event = 0
    utc_minus_service_s: float | None = None

    def __init__(
        self,
        shown: Callable[[], Iterable[FleetShown]],
        origin: str,
        problem: Callable[[], str | None] = lambda: None,
        refused: Callable[[], dict[str, int]] = dict,
    ) -> None:
        self.instance = secrets.token_hex(8)
        self.problem = problem
        self.registry = fleets_registry(shown, problem, refused)
        self._shown = shown
        self._origin = origin
        self._refused = refused

    async def metrics(self) -> bytes:
        """All fleets in the text format of Prometheus."""
        return generate_latest(self.registry)

    def events_after(self, number: int) -> EventsFrame:
        """As `PageSource` says; there are none."""
        del number
        return EventsFrame(events=(), missed=0)

    def tracks(self) -> tuple[VehicleHistory, ...]:
        """As `PageSource` says; there are none."""
        return ()

    def messages(self, *, with_counts: bool) -> list[str]:
        """As `PageSource` says."""
        del with_counts
        frame = FleetsFrame(origin=self._origin, problem=self.problem(), refused=self._refused(), fleets=tuple(self._shown()))
        return [frame.model_dump_json()]


def make_fleets_app(
    source: FleetsSource,
    pages: Pages,
    allowed_hosts: Collection[str],
    lifespan: Callable[[Starlette], AbstractAsyncContextManager[None]],
) -> Starlette:
    """The application of the page of all fleets, with its metrics and its health."""

    async def index(request: Request) -> Response:
        del request
        return FileResponse(STATIC / "fleets.html")

    async def live(socket: WebSocket) -> None:
        await serve_live(socket, pages, lambda: FleetsHello(instance=source.instance, version=__version__).model_dump_json())

    async def metrics(request: Request) -> Response:
        del request
        return Response(await source.metrics(), headers={"content-type": CONTENT_TYPE_LATEST})

    async def healthy(request: Request) -> Response:
        del request
        return PlainTextResponse("ok\n")

    async def ready(request: Request) -> Response:
        del request
        problem = source.problem()
        return PlainTextResponse("ok\n") if problem is None else PlainTextResponse(f"{problem}\n", status_code=503)

    return Starlette(
        routes=[
            Route("/", index),
            Route("/healthz", healthy),
            Route("/readyz", ready),
            Route("/metrics", metrics),
            WebSocketRoute("/live", live),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, allowed_hosts=allowed_hosts)],
        lifespan=lifespan,
    )
