"""Lulls: periodic work waits for the moment after the outputs, but not for ever, and it keeps its pace."""

import asyncio

from gcs_coloc.sinks.idle_scheduler import IdleScheduler


class SteppedLoop(asyncio.SelectorEventLoop):
    """Its time passes by hand."""

    now_s = 100.0

    def time(self) -> float:
        return self.now_s


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def turns_of(period_s: float, phase: float, lulls_at_s: list[float], until_s: float, step_s: float = 0.01) -> list[float]:
    """When the turns come, seconds after the start, with lulls at these times."""
    loop, turns = SteppedLoop(), []

    def note() -> None:
        turns.append(round(loop.now_s - 100.0, 6))

    async def scene():
        idle = IdleScheduler()

        async def work():
            async for _ in idle.every(period_s, phase):
                note()

        task = asyncio.create_task(work())
        await settle()
        for step in range(1, round(until_s / step_s) + 1):
            loop.now_s = 100.0 + step * step_s
            if any(abs(step * step_s - at_s) < 1e-9 for at_s in lulls_at_s):
                idle.begin()
            await settle()
        task.cancel()

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(scene())
    return turns


def test_each_turn_comes_with_the_first_lull_after_its_time_and_the_pace_is_kept():
    lulls_at_s = [0.03 + 0.1 * n for n in range(20)]
    assert turns_of(0.2, 0.5, lulls_at_s, 1.0) == [0.13, 0.33, 0.53, 0.73, 0.93]


def test_without_lulls_turns_come_all_the_same_half_a_period_late():
    assert turns_of(0.2, 0.0, [], 0.75) == [0.1, 0.3, 0.5, 0.7]


def test_what_was_missed_is_not_caught_up_with():
    """From 0.2 to 1.2 s the loop gets no turn of its own: one coarse step."""
    assert turns_of(0.2, 0.0, [], 4.0, step_s=1.0) == [1.0, 2.0, 3.0, 4.0]


def test_what_begins_later_falls_due_with_what_began_before_after_a_first_turn_at_once():
    loop, turns = SteppedLoop(), []

    def note(name):
        turns.append((name, round(loop.now_s - 100.0, 6)))

    async def scene():
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
            idle.begin()
            await settle()
        for task in tasks:
            task.cancel()

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(scene())
    often, seldom = ([at_s for name, at_s in turns if name == wanted] for wanted in ("often", "seldom"))
    assert seldom == [0.5, 1.0, 2.0]
    assert set(seldom[1:]) <= set(often)


def test_work_that_has_ended_is_not_waited_for():
    async def scene():
        idle = IdleScheduler()
        task = asyncio.create_task(anext(idle.every(10.0)))
        await asyncio.sleep(0)
        assert idle.waiting == 1
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert idle.waiting == 0
        idle.begin()

    asyncio.run(scene())


def test_turns_that_came_without_a_lull_are_not_remembered():
    """On the ground with the vehicles off, and in a replay, there is never one."""

    async def scene():
        idle = IdleScheduler()
        async for number in counted(idle.every(1e-4)):
            assert idle.waiting == 0
            if number == 20:
                break

    async def counted(turns):
        number = 0
        async for _ in turns:
            number += 1
            yield number

    asyncio.run(scene())
