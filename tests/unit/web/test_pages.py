"""A page that does not read loses pictures; it loses no event, and it holds up nobody."""

import asyncio
import json

from fleet_views import fleet_view

from gcs_coloc.core.outputs import Notice
from gcs_coloc.sinks.lulls import Lulls
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.story import Story


def hello():
    return '{"kind": "hello"}'


def test_a_stuck_page_gets_the_latest_picture_and_every_event_while_another_gets_all():
    async def scene():
        looks = iter(range(1, 100))
        story = Story()
        pages = Pages(lambda: fleet_frame(fleet_view(float(next(looks))), ()), story, Lulls())
        stuck, good = pages.add(), pages.add()
        may_read = asyncio.Event()
        sent = {"stuck": [], "good": []}

        async def slow(text):
            await may_read.wait()
            sent["stuck"].append(json.loads(text))

        async def quick(text):
            sent["good"].append(json.loads(text))

        tasks = [asyncio.create_task(stuck.send_all(story, hello, slow)), asyncio.create_task(good.send_all(story, hello, quick))]
        for i in range(10):
            story.take(Notice(float(i), 1, "warning", f"event {i}"))
            await pages.tick()
            for _ in range(5):
                await asyncio.sleep(0)
        assert [m["at_s"] for m in sent["good"] if m["kind"] == "fleet"] == [float(i) for i in range(1, 11)]
        may_read.set()
        for _ in range(10):
            await asyncio.sleep(0)
        for task in tasks:
            task.cancel()
        pictures = [m["at_s"] for m in sent["stuck"] if m["kind"] == "fleet"]
        assert len(pictures) <= 2
        assert pictures[-1] == 10.0
        assert stuck.skipped >= 8
        for who in sent.values():
            events = [e["text"] for m in who if m["kind"] == "events" for e in m["events"]]
            assert events == [f"event {i}" for i in range(10)]

    asyncio.run(scene())


def test_there_is_an_end_to_how_many_pages_may_be_open():
    pages = Pages(lambda: fleet_frame(fleet_view(), ()), Story(), Lulls())
    opened = [pages.add() for _ in range(32)]
    assert pages.full
    pages.remove(opened[0])
    assert not pages.full
