"""The open pages: each gets the latest picture when it can take one, and every event once. None can hold up another."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from gcs_coloc.sinks.idle_scheduler import IdleScheduler
from gcs_coloc.web.live_socket import SendFrame, text_frame
from gcs_coloc.web.track_history import TrackHistory

MOST_PAGES = 32
_PAGES_AT_A_TIME = 8


class Page:
    """One open page. It is offered every picture; one that comes before it has taken the last is not for it."""

    def __init__(self, send_frame: SendFrame) -> None:
        self.skipped = 0
        self._visible = True
        self._send_frame = send_frame
        self._instance, self._edition, self._told = "", 0, 0
        self._wake = asyncio.Event()

    @property
    def visible(self) -> bool:
        """Whether anybody looks at it: one in a tab behind others is sent events alone."""
        return self._visible

    def offer(self, story: TrackHistory, picture: bytes) -> None:
        """Send the newest picture, and have its task tell what else is new; never waits."""
        if (story.instance, story.edition) == (self._instance, self._edition):
            if self._visible and not self._send_frame(picture):
                self.skipped += 1
            if story.newest_event > self._told:
                self._wake.set()
        else:
            self._wake.set()

    def show(self, visible: bool) -> None:
        """Note whether anybody looks at it. Who looks again is told what went by, by hello's history."""
        if visible and not self._visible:
            self._edition = -1
            self._wake.set()
        self._visible = visible

    async def send_all(self, story: TrackHistory, hello: Callable[[], str], send: Callable[[str], Awaitable[None]]) -> None:
        """Send hello and then events for ever, as fast as `send` takes them; hello again where the story wants it."""
        while True:
            if (story.instance, story.edition) != (self._instance, self._edition):
                told = self._told if story.instance == self._instance else 0
                instance, edition = story.instance, story.edition
                await send(hello())
                self._instance, self._edition, self._told = instance, edition, told
            if story.newest_event > self._told:
                news, self._told = story.events_after(self._told), story.newest_event
                await send(news.model_dump_json())
            await self._wake.wait()
            self._wake.clear()


class Pages:
    """All open pages. `picture` makes the latest one, each `period_s`, and `counts` what is shown once a second, both as JSON.

    They are asked only while a page is looked at, and once for all.
    """

    def __init__(
        self, picture: Callable[[], bytes], counts: Callable[[], bytes], story: TrackHistory, idle: IdleScheduler, period_s: float
    ) -> None:
        self._picture = picture
        self._counts = counts
        self._period_s = period_s
        self._counts_every = max(round(1.0 / period_s), 1)
        self._turn = 0
        self._story = story
        self._idle = idle
        self._open: set[Page] = set()

    @property
    def full(self) -> bool:
        """Whether there are as many pages as there may be."""
        return len(self._open) >= MOST_PAGES

    def add(self, send_frame: SendFrame) -> Page:
        """A new page, to be given back with `remove`."""
        page = Page(send_frame)
        self._open.add(page)
        return page

    def remove(self, page: Page) -> None:
        """Forget a page that was closed."""
        self._open.discard(page)

    async def run(self) -> None:
        """Offer the latest picture to every page at a steady pace."""
        async for _ in self._idle.every(self._period_s):
            if self._open:
                await self.tick()

    async def tick(self) -> None:
        """Offer one picture to every page, to a few at a time: what arrives meanwhile does not wait for all of them."""
        instance = self._story.instance
        picture = self._frames() if any(page.visible for page in self._open) else b""
        for n, page in enumerate(list(self._open)):
            if n and n % _PAGES_AT_A_TIME == 0:
                await asyncio.sleep(0)
                if self._story.instance != instance:  # the picture is of another flight
                    return
            page.offer(self._story, picture)

    def _frames(self) -> bytes:
        """The frames of one turn."""
        self._turn += 1
        picture = text_frame(self._picture())
        return picture + text_frame(self._counts()) if self._turn % self._counts_every == 0 else picture
