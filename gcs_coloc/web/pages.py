"""The open pages, each of which is sent the latest picture and every event once.

A page gets the next picture as soon as it has shown the one before.
"""

from __future__ import annotations

import asyncio
import secrets
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable

from starlette.websockets import WebSocket, WebSocketDisconnect

from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.web.wire import BOTH_SHOWN, HIDDEN, SHOWN, VISIBLE, EventsFrame, VehicleHistory

MAX_PAGES = 32  # chosen: bounds what pages cost the service; nobody has as many operators
MAX_UNSHOWN = 2
"""Pictures on their way to a page. Chosen: one would halve the rate at a round trip of 0.4 s, more would show the past."""
_PICTURES_SHOWN: dict[str | None, int] = {SHOWN: 1, BOTH_SHOWN: 2}
_PAGES_AT_A_TIME = 8  # chosen: sending to them takes a millisecond


class PageSource(ABC):
    """What pages are sent: the live service's fleet, a replay's at its position, or all fleets.

    A source overrides what it has; pages of this one have no events and no tracks.
    """

    def __init__(self) -> None:
        self.instance = secrets.token_hex(8)
        """Changes where a page must forget everything it was sent.

        That is with another run, or where a replay goes back to an earlier position.
        """
        self.edition = 0
        """Changes where a page must draw the tracks anew."""

    @property
    def newest_event(self) -> int:
        """The number of the newest event; 0 before the first."""
        return 0

    @property
    def utc_minus_service_s(self) -> float | None:
        """UTC minus the service's clock, s; None where it is not known."""
        return None

    def events_after(self, number: int) -> EventsFrame:  # noqa: ARG002 - there are none
        """The events with a higher number."""
        return EventsFrame(events=(), missed=0)

    def tracks(self) -> tuple[VehicleHistory, ...]:
        """The last minutes of each vehicle."""
        return ()

    @abstractmethod
    def messages(self, *, with_counts: bool) -> list[str]:
        """The latest picture as JSON messages, the `fleet` message and others; empty where there is none yet."""


class Page:
    """One open page. Its task sends it everything; whoever offers a picture never waits."""

    def __init__(self, source: PageSource, hello: Callable[[], str], send: Callable[[str], Awaitable[None]]) -> None:
        """`hello` makes the first message, `send` sends one and may wait."""
        self.skipped = 0
        """Pictures that were replaced by a newer one before the page could be sent them."""
        self.visible = True
        """Whether the page is in sight; otherwise it is sent events alone."""
        self._source = source
        self._hello = hello
        self._send = send
        self._instance, self._edition, self._newest_event = "", 0, 0
        self._picture: tuple[str, list[str]] | None = None  # not sent yet, with its instance
        self._unshown = 0
        self._wake = asyncio.Event()

    def offer(self, instance: str, picture: list[str]) -> None:
        """Have the newest picture and new events sent.

        The picture replaces one that is not sent yet.
        """
        if picture and self.visible:
            self.skipped += self._picture is not None
            self._picture = instance, picture
        self._wake.set()

    def receive(self, text: str | None) -> None:
        """Apply a message of the page: pictures shown, out of sight or in sight again."""
        if text in _PICTURES_SHOWN:
            self._unshown = max(self._unshown - _PICTURES_SHOWN[text], 0)
            if self._picture is None:
                return  # nothing waits for it: most acknowledgements wake nobody
        elif text == HIDDEN:
            self.visible = False
            self._picture = None
        elif text == VISIBLE and not self.visible:
            self.visible = True
            self._edition = -1  # hello's tracks show what has passed meanwhile
        self._wake.set()

    async def send_all(self) -> None:
        """Send hello, events and pictures for ever, as fast as the page accepts them."""
        source = self._source
        while True:
            self._wake.clear()
            if (source.instance, source.edition) != (self._instance, self._edition):
                if source.instance != self._instance:
                    self._newest_event = 0
                self._instance, self._edition = source.instance, source.edition
                await self._send(self._hello())
            if source.newest_event > self._newest_event:
                events, self._newest_event = source.events_after(self._newest_event), source.newest_event
                await self._send(events.model_dump_json())
            if self._picture is not None and self._unshown < MAX_UNSHOWN:
                (instance, messages), self._picture = self._picture, None
                if instance == self._instance:
                    self._unshown += 1
                    for message in messages:
                        await self._send(message)
            await self._wake.wait()


class Pages:
    """All open pages.

    The source is asked for a picture only while a page is in sight, and once for all pages.
    """

    def __init__(self, source: PageSource, idle: IdleScheduler, period_s: float) -> None:
        """Offer a picture every `period_s`, in idle time."""
        self.source = source
        self._idle = idle
        self._period_s = period_s
        self._counts_every = max(round(1.0 / period_s), 1)
        self._turn = 0
        self._open: set[Page] = set()

    @property
    def full(self) -> bool:
        """Whether there are as many pages as there may be."""
        return len(self._open) >= MAX_PAGES

    def add(self, hello: Callable[[], str], send: Callable[[str], Awaitable[None]]) -> Page:
        """Add a new page and return it; `remove` removes it again."""
        page = Page(self.source, hello, send)
        self._open.add(page)
        return page

    def remove(self, page: Page) -> None:
        """Forget a page that was closed."""
        self._open.discard(page)

    async def run(self) -> None:
        """Offer the latest picture to every page, for ever."""
        async for _ in self._idle.every(self._period_s):
            if self._open:
                await self.offer_picture()

    async def offer_picture(self) -> None:
        """Offer one picture to every page, to a few pages at a time.

        Between them the event loop runs, so that what arrives meanwhile does not wait for all pages.
        """
        picture: list[str] = []
        if any(page.visible for page in self._open):
            self._turn += 1
            picture = self.source.messages(with_counts=self._turn % self._counts_every == 0)
        instance = self.source.instance
        for n, page in enumerate(list(self._open)):
            if n and n % _PAGES_AT_A_TIME == 0:
                await asyncio.sleep(0)
            page.offer(instance, picture)


async def serve_live(socket: WebSocket, pages: Pages, hello: Callable[[], str]) -> None:
    """Send one page hello, then events and pictures, until it is closed."""
    if pages.full:
        await socket.close(1013, "too many pages are open")
        return
    page = pages.add(hello, socket.send_text)
    sender: asyncio.Task[None] | None = None
    try:
        await socket.accept()
        sender = asyncio.create_task(page.send_all())
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            page.receive(message.get("text"))
    except WebSocketDisconnect:
        pass
    finally:
        pages.remove(page)
        if sender is not None:
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)
