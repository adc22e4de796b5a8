"""Tasks on several cores or on a Dask cluster, with progress.

The results are the same wherever they are computed.

A task is a picklable function with a picklable argument, is seeded where it draws noise, and can be done again: a worker that
dies loses nothing, as its task is given to another one. Results may be kept, a file for each in a directory, so that a run that
was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from gcs_coloc.core.errors import TaskError, UsageError
from gcs_coloc.runtime.files import make_output_directory
from gcs_coloc.runtime.pool import Pool, ProcessPool, Result, Task
from gcs_coloc.runtime.program import program_versions

Progress = Callable[[int, int], None]
"""Called with how many of how many tasks are done."""

_MOST_DEATHS = 3
"""So many processes in a row may die before one task is done. Chosen, as Dask's `allowed-failures`: then the tasks kill them."""
_LOOK_EVERY_S = 5.0
"""Chosen: how late workers that join are given tasks, where all others take long, and that none is left is told."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Workers:
    """Where tasks run: in processes of this machine, or on a Dask cluster.

    `jobs` is how many processes; 1: this one. `scheduler` is the address of the cluster's scheduler; None: this machine.
    """

    jobs: int = 1
    scheduler: str | None = None


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: Workers,
    progress: Progress,
    kept: KeptResults | None = None,
) -> list[Result]:
    """Return the function's results in the order of the tasks.

    With `kept`, a result that is kept is not computed again, and a new one is kept.

    Raises:
        ClusterError: the cluster cannot be used.
        TaskError: processes die again and again.
        UsageError: kept results cannot be read or written.
    """
    results: dict[int, Result] = {}
    paths = [kept.path_of(function, task) for task in tasks] if kept is not None else []
    for index, path in enumerate(paths):
        if kept is not None and path.exists():
            results[index] = cast("Result", kept.load(path))
    missing = [index for index in range(len(tasks)) if index not in results]
    progress(len(results), len(tasks))
    jobs = min(workers.jobs, len(missing))
    for place, result in _completed(function, [tasks[index] for index in missing], replace(workers, jobs=jobs)):
        index = missing[place]
        if kept is not None:
            kept.store(paths[index], result)
        results[index] = result
        progress(len(results), len(tasks))
    return [results[index] for index in range(len(tasks))]


def iterate_tasks(function: Callable[[Task], Result], tasks: Iterable[Task], workers: Workers) -> Iterator[Result]:
    """Yield the function's results as they are ready, in any order.

    No further task starts once the caller stops reading.

    Raises:
        ClusterError: the cluster cannot be used.
        TaskError: processes die again and again.
    """
    for _, result in _completed(function, tasks, workers):
        yield result


def _completed(function: Callable[[Task], Result], tasks: Iterable[Task], workers: Workers) -> Iterator[tuple[int, Result]]:
    """Yield results with the place of their task as they are ready.

    The first task is drawn when the pool is there.
    """
    if workers.scheduler is None and workers.jobs <= 1:
        for place, task in enumerate(tasks):
            yield place, function(task)
        return
    left = enumerate(tasks)
    again: deque[tuple[int, Task]] = deque()
    pending: dict[Future[Result], tuple[int, Task]] = {}
    deaths, was_told = 0, False
    with _open_pool(workers) as pool:
        while True:
            is_broken = False
            capacity = pool.capacity()
            while len(pending) < max(capacity, 1) and not is_broken and (drawn := again.popleft() if again else next(left, None)):
                try:
                    pending[pool.submit(function, drawn[1])] = drawn
                except BrokenExecutor:
                    again.append(drawn)
                    is_broken = True
            if not pending and not again:
                return
            done, _ = wait(pending, _LOOK_EVERY_S, FIRST_COMPLETED)
            for future in done:
                if isinstance(future.exception(), BrokenExecutor):
                    is_broken = True
                    continue
                place, _ = pending.pop(future)
                yield place, future.result()
                deaths = 0
            if is_broken:
                deaths += 1
                if deaths >= _MOST_DEATHS:
                    raise TaskError(f"{deaths} processes in a row were killed, perhaps for want of memory; try fewer --jobs")
                again.extend(sorted(pending.values(), key=lambda item: item[0]))
                pending.clear()
                pool.restart()
            if not capacity and not was_told:
                _log.warning("no worker is left at %s; waiting for one", workers.scheduler)
            was_told = not capacity


def _open_pool(workers: Workers) -> AbstractContextManager[Pool]:
    if workers.scheduler is None:
        return ProcessPool(workers.jobs)
    # Here, because the package is an extra, and takes a second to import.
    from gcs_coloc.runtime.dask_cluster import connect

    return connect(workers.scheduler)


class KeptResults:
    """Results in a directory, each under what was computed: program, function and task.

    Another program or task finds nothing of these.
    """

    def __init__(self, directory: Path, option: str = "--resume") -> None:
        """Make the directory, which `option` names, where there is none.

        Raises:
            UsageError: it is a file, or may not be made.
        """
        make_output_directory(directory, option)
        self._directory = directory
        self._option = option

    def path_of(self, function: Callable[..., object], task: object) -> Path:
        """Return the file of a task's result; it exists where the task was done."""
        digest = hashlib.sha256(pickle.dumps((program_versions(), function, task)))
        return self._directory / f"{digest.hexdigest()[:32]}.pickle"

    def load(self, path: Path) -> object:
        """Return a result.

        Raises:
            UsageError: it cannot be read.
        """
        try:
            result: object = pickle.loads(path.read_bytes())  # noqa: S301 - as much the user's own as the program is
        except Exception as error:  # a damaged pickle can raise any
            raise UsageError(f"{self._option} {self._directory}: {path.name} cannot be read ({error}); delete it") from None
        return result

    def store(self, path: Path, result: object) -> None:
        """Write a result: whole, or, where the program is stopped meanwhile, not at all.

        Raises:
            UsageError: it cannot be written.
        """
        draft = path.with_suffix(".part")
        try:
            draft.write_bytes(pickle.dumps(result))
            draft.replace(path)
        except OSError as error:
            raise UsageError(f"{self._option} {self._directory}: cannot be written to: {error.strerror}") from None
