"""A page that does not read loses pictures; it loses no event, and it holds up nobody."""

import asyncio
import json
from contextlib import asynccontextmanager

from fleet_views import fleet_view

from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.sinks.idle_scheduler import IdleScheduler
from gcs_coloc.web.live_socket import text_frame
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import fleet_json


def messages(frames):
    """The texts of unmasked frames, none longer than 64 KiB."""
    out = []
    while frames:
        size, start = (frames[1], 2) if frames[1] < 126 else (int.from_bytes(frames[2:4], "big"), 4)
        out.append(json.loads(frames[start : start + size]))
        frames = frames[start + size :]
    return out


class Browser:
    """What a page was sent, in its order; `reads` False: it takes nothing."""

    def __init__(self):
        self.got = []
        self.reads = True
        self._may_read = asyncio.Event()

    def send_frame(self, frame):
        if self.reads:
            self.got += messages(frame)
        return self.reads

    async def send(self, text):
        while not self.reads:
            await self._may_read.wait()
        self.got.append(json.loads(text))

    def read_again(self):
        self.reads = True
        self._may_read.set()

    def of(self, kind):
        return [m for m in self.got if m["kind"] == kind]


def hello():
    return '{"kind": "hello"}'


class Scene:
    def __init__(self):
        self.story = TrackHistory()
        self.made = 0
        self.pages = Pages(self.picture, self.counts, self.story, IdleScheduler(), 0.2)

    def picture(self):
        self.made += 1
        return fleet_json(fleet_frame(fleet_view(float(self.made))))

    def counts(self):
        return self.story.counts(fleet_view(float(self.made))).model_dump_json().encode()

    @asynccontextmanager
    async def opened(self, *browsers):
        pages = [self.pages.add(browser.send_frame) for browser in browsers]
        tasks = [asyncio.create_task(page.send_all(self.story, hello, b.send)) for page, b in zip(pages, browsers, strict=True)]
        try:
            await settle()
            yield pages
        finally:
            for task in tasks:
                task.cancel()

    async def tick(self):
        await self.pages.tick()
        await settle()


async def settle():
    for _ in range(5):
        await asyncio.sleep(0)


def test_a_stuck_page_gets_the_next_picture_and_every_event_while_another_gets_all():
    async def go():
        scene, stuck, good = Scene(), Browser(), Browser()
        async with scene.opened(stuck, good) as (stuck_page, good_page):
            stuck.reads = False
            for i in range(10):
                scene.story.take(Notice(float(i), 1, "warning", f"event {i}"))
                await scene.tick()
            assert [m["at_s"] for m in good.of("fleet")] == [float(i) for i in range(1, 11)]
            assert (stuck_page.skipped, good_page.skipped) == (10, 0)
            assert not stuck.of("fleet")
            stuck.read_again()
            await scene.tick()
            assert [m["at_s"] for m in stuck.of("fleet")] == [11.0]
        for browser in (stuck, good):
            assert [e["text"] for m in browser.of("events") for e in m["events"]] == [f"event {i}" for i in range(10)]

    asyncio.run(go())


def test_a_page_that_nobody_looks_at_gets_events_alone_and_the_history_when_somebody_does_again():
    async def go():
        scene, hidden, seen = Scene(), Browser(), Browser()
        async with scene.opened(hidden, seen) as (hidden_page, seen_page):
            hidden_page.show(False)
            scene.story.take(Notice(1.0, 1, "warning", "lost"))
            await scene.tick()
            assert [m["kind"] for m in hidden.got] == ["hello", "events"]
            assert [m["kind"] for m in seen.got] == ["hello", "fleet", "events"]
            seen_page.show(False)
            await scene.tick()
            assert scene.made == 1
            hidden_page.show(True)
            await settle()
            await scene.tick()
            assert [m["kind"] for m in hidden.got] == ["hello", "events", "hello", "fleet"]
            hidden_page.show(True)
            await scene.tick()
            assert len(hidden.of("hello")) == 2

    asyncio.run(go())


def test_a_page_is_told_of_another_flight_before_it_sees_a_picture_of_it():
    async def go():
        scene, browser = Scene(), Browser()
        async with scene.opened(browser):
            await scene.tick()
            scene.story.reset()
            await scene.tick()
            await scene.tick()
            assert [m["kind"] for m in browser.got] == ["hello", "fleet", "hello", "fleet"]

    asyncio.run(go())


def test_what_is_counted_comes_with_every_fifth_picture():
    async def go():
        scene, browser = Scene(), Browser()
        async with scene.opened(browser):
            for _ in range(10):
                await scene.tick()
        assert [m["kind"] for m in browser.got] == ["hello", *[*["fleet"] * 5, "counts"] * 2]

    asyncio.run(go())


def test_a_frame_for_all_pages_is_one_unmasked_text_frame():
    assert text_frame("é".encode()) == b"\x81\x02\xc3\xa9"
    assert text_frame(b"x" * 300)[:4] == b"\x81\x7e\x01\x2c"


def test_there_is_an_end_to_how_many_pages_may_be_open():
    pages = Scene().pages
    opened = [pages.add(lambda frame: True) for _ in range(32)]
    assert pages.full
    pages.remove(opened[0])
    assert not pages.full
