"""The open pages: each gets the latest picture when it can take one, and every event once. None can hold up another."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from gcs_coloc.sinks.lulls import Lulls
from gcs_coloc.web.story import Story
from gcs_coloc.web.wire import FleetFrame

PERIOD_S = 0.2
MOST_PAGES = 32
_PAGES_AT_A_TIME = 2


class Page:
    """One open page. It holds at most one picture: a newer one takes the place of one that was not sent in time."""

    def __init__(self) -> None:
        self.skipped = 0
        self._picture: tuple[str, str] | None = None
        self._wake = asyncio.Event()

    def offer(self, instance: str, picture: str) -> None:
        """Put the newest picture of a story's instance in place; never waits."""
        if self._picture is not None:
            self.skipped += 1
        self._picture = (instance, picture)
        self._wake.set()

    async def send_all(self, story: Story, hello: Callable[[], str], send: Callable[[str], Awaitable[None]]) -> None:
        """Send hello, then events and pictures for ever, as fast as `send` takes them; hello again where the story wants it."""
        instance, edition, told = "", 0, 0
        while True:
            if (story.instance, story.edition) != (instance, edition):
                told = told if story.instance == instance else 0
                instance, edition = story.instance, story.edition
                await send(hello())
            if story.newest_event > told:
                news, told = story.events_after(told), story.newest_event
                await send(news.model_dump_json())
            if self._picture is not None:
                (of, picture), self._picture = self._picture, None
                if of == story.instance == instance:
                    await send(picture)
            await self._wake.wait()
            self._wake.clear()


class Pages:
    """All open pages. `picture` makes the latest one; it is asked only while a page is open, and once for all."""

    def __init__(self, picture: Callable[[], FleetFrame], story: Story, lulls: Lulls) -> None:
        self._make = picture
        self._story = story
        self._lulls = lulls
        self._open: set[Page] = set()

    @property
    def full(self) -> bool:
        """Whether there are as many pages as there may be."""
        return len(self._open) >= MOST_PAGES

    def add(self) -> Page:
        """A new page, to be given back with `remove`."""
        page = Page()
        self._open.add(page)
        return page

    def remove(self, page: Page) -> None:
        """Forget a page that was closed."""
        self._open.discard(page)

    async def run(self) -> None:
        """Offer the latest picture to every page at a steady pace."""
        async for _ in self._lulls.every(PERIOD_S):
            if self._open:
                await self.tick()

    async def tick(self) -> None:
        """Offer one picture to every page, to a few at a time: what arrives meanwhile does not wait for all of them."""
        instance, picture = self._story.instance, self._make().model_dump_json()
        for n, page in enumerate(list(self._open), start=1):
            page.offer(instance, picture)
            if n % _PAGES_AT_A_TIME == 0:
                await asyncio.sleep(0)
