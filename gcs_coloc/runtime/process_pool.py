"""A pool of processes for tasks on several cores, with progress; the results are in order on any number of cores."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, as_completed, wait
from itertools import islice
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

Progress = Callable[[int, int], None]
"""Called with how many of how many tasks are done."""


def run_tasks(function: Callable[[Task], Result], tasks: Sequence[Task], jobs: int, progress: Progress) -> list[Result]:
    """Return the function's results in the order of the tasks.

    With one job everything runs in this process; otherwise the function, tasks and results must be picklable.
    """
    progress(0, len(tasks))
    if jobs <= 1:
        results = []
        for done, task in enumerate(tasks, start=1):
            results.append(function(task))
            progress(done, len(tasks))
        return results
    # A forked child would inherit the locks of whatever threads its parent has.
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(function, task) for task in tasks]
        for done, _ in enumerate(as_completed(futures), start=1):
            progress(done, len(tasks))
        return [future.result() for future in futures]


def iterate_tasks(function: Callable[[Task], Result], tasks: Iterable[Task], jobs: int) -> Iterator[Result]:
    """Yield the function's results as they are ready, in any order; whoever stops reading starts no further tasks.

    With one job everything runs in this process; otherwise the function, tasks and results must be picklable.
    """
    if jobs <= 1:
        yield from map(function, tasks)
        return
    left = iter(tasks)
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        pending = {pool.submit(function, task) for task in islice(left, jobs)}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            pending |= {pool.submit(function, task) for task in islice(left, len(done))}
            for future in done:
                yield future.result()
