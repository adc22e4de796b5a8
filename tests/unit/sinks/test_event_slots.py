"""Periodic work waits for the moment after the outputs, but not for ever, and it keeps its pace."""

import asyncio

from gcs_coloc.sinks.event_bus import IdleScheduler


class SteppedLoop(asyncio.SelectorEventLoop):
    """Its time passes by hand."""

    now_s = 100.0

    def time(self) -> float:
        return self.now_s


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def slots_of(period_s: float, phase: float, outputs_sent_at_s: list[float], until_s: float, step_s: float = 0.01) -> list[float]:
    """When the slots start, seconds after the beginning, with outputs sent at these times."""
    loop, slots = SteppedLoop(), []

    def note() -> None:
        slots.append(round(loop.now_s - 100.0, 6))

    async def case():
        idle = IdleScheduler()

        async def work():
            async for _ in idle.every(period_s, phase):
                note()

        task = asyncio.create_task(work())
        await settle()
        for step in range(1, round(until_s / step_s) + 1):
            loop.now_s = 100.0 + step * step_s
            if any(abs(step * step_s - at_s) < 1e-9 for at_s in outputs_sent_at_s):
                idle.start_slots()
            await settle()
        task.cancel()

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(case())
    return slots


def test_each_slot_starts_with_the_first_idle_time_after_it_is_due_and_the_pace_is_kept():
    outputs_sent_at_s = [0.03 + 0.1 * n for n in range(20)]
    assert slots_of(0.2, 0.5, outputs_sent_at_s, 1.0) == [0.13, 0.33, 0.53, 0.73, 0.93]


def test_without_idle_time_slots_start_half_a_period_late():
    assert slots_of(0.2, 0.0, [], 0.75) == [0.1, 0.3, 0.5, 0.7]


def test_what_was_missed_is_not_caught_up_with():
    """From 0.2 to 1.2 s the loop is not run: one coarse step."""
    assert slots_of(0.2, 0.0, [], 4.0, step_s=1.0) == [1.0, 2.0, 3.0, 4.0]


def test_what_begins_later_falls_due_with_what_began_before_after_a_first_slot_at_once():
    loop, slots = SteppedLoop(), []

    def note(name):
        slots.append((name, round(loop.now_s - 100.0, 6)))

    async def case():
        idle = IdleScheduler()

        async def work(name, period_s):
            async for _ in idle.every(period_s):
                note(name)

        tasks = [asyncio.create_task(work("often", 0.2))]
        await settle()
        for step in range(1, 24):
            loop.now_s = 100.0 + 0.1 * step
            if step == 5:
                tasks.append(asyncio.create_task(work("seldom", 1.0)))
                await settle()
            idle.start_slots()
            await settle()
        for task in tasks:
            task.cancel()

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(case())
    often, seldom = ([at_s for name, at_s in slots if name == wanted] for wanted in ("often", "seldom"))
    assert seldom == [0.5, 1.0, 2.0]
    assert set(seldom[1:]) <= set(often)


def test_work_that_has_ended_is_not_waited_for():
    async def case():
        idle = IdleScheduler()
        task = asyncio.create_task(anext(idle.every(10.0)))
        await asyncio.sleep(0)
        assert idle.waiting == 1
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert idle.waiting == 0
        idle.start_slots()

    asyncio.run(case())


def test_slots_that_started_without_idle_time_are_not_remembered():
    """On the ground with the vehicles off, and in a replay, there is never one."""

    async def case():
        idle = IdleScheduler()
        async for number in counted(idle.every(1e-4)):
            assert idle.waiting == 0
            if number == 20:
                break

    async def counted(slots):
        number = 0
        async for _ in slots:
            number += 1
            yield number

    asyncio.run(case())
