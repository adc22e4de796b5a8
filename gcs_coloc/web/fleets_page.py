"""The page of all fleets: the messages to it, and the application that serves it.

The page shows the fleets and has no commands.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractAsyncContextManager
from typing import Literal

from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import BaseModel, ConfigDict
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from gcs_coloc import __version__
from gcs_coloc.sinks.metrics import fleets_registry
from gcs_coloc.sinks.watched_fleets import FleetShown
from gcs_coloc.web.app import page_app
from gcs_coloc.web.pages import Pages, PageSource

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


class FleetsSource(PageSource):
    """What the page of all fleets is sent; a `PageSource`.

    `shown` returns the fleets as they stand, `origin` says in words where their states come from, `problem` what keeps them from
    coming, `refused` how often what was not understood, by reason.
    """

    def __init__(
        self,
        shown: Callable[[], Iterable[FleetShown]],
        origin: str,
        problem: Callable[[], str | None] = lambda: None,
        refused: Callable[[], dict[str, int]] = dict,
    ) -> None:
        super().__init__()
        self.problem = problem
        self.registry = fleets_registry(shown, problem, refused)
        self._shown = shown
        self._origin = origin
        self._refused = refused

    async def metrics(self) -> bytes:
        """All fleets in the text format of Prometheus."""
        return generate_latest(self.registry)

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

    async def metrics(_: Request) -> Response:
        return Response(await source.metrics(), headers={"content-type": CONTENT_TYPE_LATEST})

    def hello() -> str:
        return FleetsHello(instance=source.instance, version=__version__).model_dump_json()

    return page_app("fleets.html", pages, hello, source.problem, [Route("/metrics", metrics)], allowed_hosts, lifespan)
