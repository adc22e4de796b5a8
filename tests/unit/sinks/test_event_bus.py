"""The event bus: a slow observer loses its own oldest events and holds up nobody."""

import asyncio

from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.sinks.event_bus import EventBus


def notice(i: int) -> Notice:
    return Notice(float(i), None, "info", str(i))


def test_each_observer_gets_all_events_in_order():
    async def scenario():
        events = EventBus()
        one, two = events.subscribe(), events.subscribe()
        for i in range(3):
            events.publish(notice(i))
        return [(await one.get()).text for _ in range(3)], [(await two.get()).text for _ in range(3)]

    assert asyncio.run(scenario()) == (["0", "1", "2"], ["0", "1", "2"])


def test_a_slow_observer_loses_its_oldest_events_and_counts_them():
    async def scenario():
        events = EventBus()
        slow, fast = events.subscribe(most=2), events.subscribe(most=10)
        for i in range(5):
            events.publish(notice(i))
        return [(await slow.get()).text for _ in range(2)], slow.lost, fast.lost

    assert asyncio.run(scenario()) == (["3", "4"], 3, 0)


def test_an_observer_that_waits_is_woken():
    async def scenario():
        events = EventBus()
        subscription = events.subscribe()
        waiting = asyncio.create_task(subscription.get())
        await asyncio.sleep(0)
        events.publish(notice(7))
        return (await asyncio.wait_for(waiting, 60)).text

    assert asyncio.run(scenario()) == "7"
