"""A page that shows nothing loses pictures; it loses no event, and it holds up nobody."""

import asyncio
import json
from contextlib import asynccontextmanager

from fleet_views import fleet_view

from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.web.pages import MAX_UNSHOWN, Pages
from gcs_coloc.web.picture import LiveSource


class Browser:
    """What a page was sent, in order. With `shows` False it acknowledges no picture."""

    def __init__(self):
        self.got = []
        self.shows = True
        self.page = None
        self._may_read = asyncio.Event()
        self._may_read.set()

    def set_reading(self, reads):
        (self._may_read.set if reads else self._may_read.clear)()

    async def send(self, text):
        await self._may_read.wait()
        message = json.loads(text)
        self.got.append(message)
        if message["kind"] == "fleet" and self.shows:
            self.page.receive("shown")

    def of(self, kind):
        return [m for m in self.got if m["kind"] == kind]

    def kinds(self):
        return [m["kind"] for m in self.got]


def hello():
    return '{"kind": "hello"}'


class Served:
    """Pages of a live source whose pictures are numbered by their time."""

    def __init__(self):
        self.made = 0
        self.source = LiveSource(lambda: fleet_view(float(self.made)), self.next_snapshot, lambda _: ())
        self.pages = Pages(self.source, IdleScheduler(), 0.2)

    def next_snapshot(self):
        self.made += 1
        return fleet_view(float(self.made))

    @asynccontextmanager
    async def opened(self, *browsers):
        for browser in browsers:
            browser.page = self.pages.add(hello, browser.send)
        tasks = [asyncio.create_task(browser.page.send_all()) for browser in browsers]
        try:
            await settle()
            yield
        finally:
            for task in tasks:
                task.cancel()

    async def tick(self):
        await self.pages.offer_picture()
        await settle()


async def settle():
    for _ in range(5):
        await asyncio.sleep(0)


def test_a_page_whose_connection_is_stuck_gets_the_newest_picture_and_every_event_while_another_gets_all():
    async def go():
        served, stuck, good = Served(), Browser(), Browser()
        async with served.opened(stuck, good):
            stuck.set_reading(False)
            for i in range(10):
                served.source.add(Notice(float(i), 1, "warning", f"event {i}"))
                await served.tick()
            assert [m["at_s"] for m in good.of("fleet")] == [float(i) for i in range(1, 11)]
            assert (stuck.page.skipped, good.page.skipped) == (9, 0)
            assert not stuck.of("fleet")
            stuck.set_reading(True)
            await settle()
            assert [m["at_s"] for m in stuck.of("fleet")] == [10.0]
        for browser in (stuck, good):
            assert [e["text"] for m in browser.of("events") for e in m["events"]] == [f"event {i}" for i in range(10)]

    asyncio.run(go())


def test_a_page_that_acknowledges_nothing_gets_two_pictures_and_the_newest_when_it_does():
    async def go():
        served, slow = Served(), Browser()
        slow.shows = False
        async with served.opened(slow):
            for _ in range(10):
                await served.tick()
            assert [m["at_s"] for m in slow.of("fleet")] == [1.0, 2.0]
            assert MAX_UNSHOWN == 2
            slow.page.receive("shown")
            await settle()
            assert [m["at_s"] for m in slow.of("fleet")] == [1.0, 2.0, 10.0]

    asyncio.run(go())


def test_a_page_may_acknowledge_two_pictures_at_once():
    async def go():
        served, slow = Served(), Browser()
        slow.shows = False
        async with served.opened(slow):
            for _ in range(3):
                await served.tick()
            slow.page.receive("both shown")
            await settle()
            await served.tick()
            await served.tick()
            assert [m["at_s"] for m in slow.of("fleet")] == [1.0, 2.0, 3.0, 4.0]

    asyncio.run(go())


def test_a_page_out_of_sight_gets_events_alone_and_the_history_when_it_is_in_sight_again():
    async def go():
        served, hidden, seen = Served(), Browser(), Browser()
        async with served.opened(hidden, seen):
            hidden.page.receive("hidden")
            served.source.add(Notice(1.0, 1, "warning", "lost"))
            await served.tick()
            assert hidden.kinds() == ["hello", "events"]
            assert seen.kinds() == ["hello", "events", "fleet"]
            seen.page.receive("hidden")
            await served.tick()
            assert served.made == 1
            hidden.page.receive("visible")
            await settle()
            await served.tick()
            assert hidden.kinds() == ["hello", "events", "hello", "fleet"]
            hidden.page.receive("visible")
            await served.tick()
            assert len(hidden.of("hello")) == 2

    asyncio.run(go())


def test_a_page_gets_hello_of_another_instance_before_its_events_and_never_an_older_picture():
    async def go():
        served, browser = Served(), Browser()
        browser.shows = False
        async with served.opened(browser):
            for _ in range(3):
                await served.tick()
            served.source.add(Notice(1.0, 1, "warning", "again"))
            served.source.instance = "another"
            browser.page.receive("shown")
            await settle()
            assert browser.kinds() == ["hello", "fleet", "fleet", "hello", "events"]
            await served.tick()
            assert browser.of("fleet")[-1]["at_s"] == 4.0

    asyncio.run(go())


def test_the_counts_come_with_every_fifth_picture():
    async def go():
        served, browser = Served(), Browser()
        async with served.opened(browser):
            for _ in range(10):
                await served.tick()
        assert browser.kinds() == ["hello", *[*["fleet"] * 5, "counts"] * 2]

    asyncio.run(go())


def test_the_number_of_open_pages_is_bounded():
    pages = Served().pages
    opened = [pages.add(hello, Browser().send) for _ in range(32)]
    assert pages.full
    pages.remove(opened[0])
    assert not pages.full
