"""A pool that runs tasks, and the one of processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from types import TracebackType
from typing import Protocol, TypeVar

from gcs_coloc.runtime.process import collect_seldom

Task = TypeVar("Task")
Result = TypeVar("Result")


class Pool(Protocol):
    """A pool that runs tasks. It is a context; leaving it ends what is still running."""

    def capacity(self) -> int:
        """Return how many tasks may be submitted and not done; it may change."""

    def submit(self, function: Callable[[Task], Result], task: Task) -> Future[Result]:
        """Have a task done. Raises BrokenExecutor where the pool has to be restarted."""

    def restart(self) -> None:
        """Begin anew after a future ended with BrokenExecutor."""


class ProcessPool:
    """A pool of processes of this machine."""

    def __init__(self, jobs: int) -> None:
        """Start with no process; up to `jobs` come as tasks are submitted."""
        self._jobs = jobs
        self._executor = self._new_executor()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._executor.shutdown(cancel_futures=True)

    def capacity(self) -> int:
        """Return how many processes there may be."""
        return self._jobs

    def submit(self, function: Callable[[Task], Result], task: Task) -> Future[Result]:
        """Have a task done by the next process that is free."""
        return self._executor.submit(function, task)

    def restart(self) -> None:
        """Begin anew after a process was killed."""
        self._executor.shutdown()
        self._executor = self._new_executor()

    def _new_executor(self) -> Executor:
        # A forked child would inherit the locks of whatever threads its parent has.
        return ProcessPoolExecutor(self._jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_begin_worker)


def _begin_worker() -> None:
    """Initialise a worker process: it ends as soon as the program that started it has ended.

    Its task may go on for minutes, and nobody wants it then. Its garbage collection is that of the program.
    """
    collect_seldom()
    program = multiprocessing.parent_process()
    assert program is not None

    def wait_for_its_end() -> None:
        program.join()
        os._exit(1)

    threading.Thread(target=wait_for_its_end, daemon=True).start()
