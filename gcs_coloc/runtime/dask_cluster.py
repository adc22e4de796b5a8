"""A Dask cluster that runs tasks; it needs the extra `cluster`.

Its scheduler is at an address, and its workers have the same program as this process.
"""

from __future__ import annotations

import logging
import pickle
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from gcs_coloc.core.errors import ClusterError, UsageError
from gcs_coloc.runtime.pool import Pool, Result, Task
from gcs_coloc.runtime.process import collect_seldom
from gcs_coloc.runtime.program import program_versions

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_WITHIN_S = 5.0
"""Chosen: a scheduler on any network answers within a second; one that is just being started within five."""
_TASKS_A_THREAD = 2
"""One that runs and one that waits on the worker, so that it never idles while a result goes back."""


def check_address(address: str) -> None:
    """Check the form of a scheduler's address.

    Raises:
        UsageError: it is none.
    """
    found = re.fullmatch(r"(?:tcp|tls)://(?:[^\s/:\[\]]+|\[[0-9a-fA-F:.%]+\]):(\d{1,5})", address)
    if found is None or not 1 <= int(found[1]) <= 65_535:
        raise UsageError(f"--scheduler {address}: expected tcp://HOST:PORT or tls://HOST:PORT, as tcp://192.168.1.10:8786")


@contextmanager
def connect(address: str) -> Iterator[Pool]:
    """Connect to a scheduler; tasks that are not done when the context is left are cancelled.

    Raises:
        ClusterError: the extra is missing, nobody answers, there is no worker, a worker has another program, or, while tasks are
            done, the scheduler is gone or workers die of a task.
        UsageError: the address is none.
    """
    check_address(address)
    try:
        from distributed import Client, KilledWorker
    except ModuleNotFoundError as error:
        text = f"--scheduler needs the extra cluster: pip install 'gcs-coloc[cluster]' ({error.name} is missing)"
        raise ClusterError(text) from None
    # It would tell in many lines what is told in one here.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=_CONNECT_WITHIN_S, set_as_default=False)
    except (TimeoutError, OSError) as error:
        # Of several causes below one another the innermost says what is wrong.
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        remedy = "start one with `dask scheduler`, or correct --scheduler"
        raise ClusterError(f"no Dask scheduler answers at {address}: {str(cause) or 'no answer in time'}; {remedy}") from None
    try:
        with client:
            _check_workers(client, address)
            yield _Cluster(client)
    except KilledWorker as error:
        text = f"a task was on {error.allowed_failures + 1} workers in a row that died, perhaps for want of memory"
        raise ClusterError(f"{text}; give them more memory or fewer threads: what is written stays") from None
    except CancelledError:
        raise ClusterError(f"the Dask scheduler at {address} is gone; start it and run the command again") from None


def _check_workers(client: Client, address: str) -> None:
    """Raise ClusterError where there is no worker or one has another program."""
    found: Mapping[str, Any] = client.run(program_versions, on_error="return")
    if not found:
        raise ClusterError(f"the Dask scheduler at {address} has no worker; start one with `dask worker {address} --nthreads 1`")
    for worker, versions in found.items():
        if isinstance(versions, BaseException):
            raise ClusterError(f"worker {worker} cannot import gcs-coloc: {versions}; install this version there")
        _compare(worker, versions)


def _compare(worker: str, versions: Mapping[str, str], here: Mapping[str, str] | None = None) -> None:
    here = here if here is not None else program_versions()
    for name, wanted in here.items():
        if (its := versions.get(name, "none")) != wanted:
            what = "another source of this version" if name == "source" else f"{name} {its}, not {wanted}"
            raise ClusterError(f"worker {worker} has {what}: its results could differ; install the same there as here")


class _Cluster:
    """The workers of a scheduler."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor = client.get_executor()

    def capacity(self) -> int:
        threads: Mapping[str, int] = self._client.nthreads()
        return _TASKS_A_THREAD * sum(threads.values())

    def submit(self, function: Callable[[Task], Result], task: Task) -> Future[Result]:
        # Packed here: Dask would look through the argument for futures of its own.
        future: Future[Result] = self._executor.submit(_do, program_versions(), pickle.dumps((function, task)))
        return future

    def restart(self) -> None:
        """Do nothing: the scheduler itself gives the task of a worker that died to another."""


def _do(wanted: Mapping[str, str], packed: bytes) -> object:
    """Do a task on a worker. One that joined later may have another program."""
    if program_versions() != wanted:
        from distributed import get_worker

        _compare(get_worker().address, program_versions(), wanted)
    collect_seldom()
    function, task = pickle.loads(packed)  # noqa: S301 - from the scheduler, which could have any code run here anyway
    result: object = function(task)
    return result
