"""A real Dask scheduler and real workers on loopback, each a process of its own; and tasks for them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_QUIET = ("--no-dashboard", "--host", "127.0.0.1")


class DaskProcess:
    """A scheduler or worker. `line` is the one with which it said that it is ready."""

    def __init__(self, arguments: list[str], ready: str, environment: Mapping[str, str] | None = None) -> None:
        # The workers import the program, and the tasks below, from here; in place of the nanny one thread is seen to here.
        paths = os.pathsep.join([str(ROOT), str(Path(__file__).parent)])
        own = {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"} | dict(environment or {})
        command = [sys.executable, "-m", "dask", *arguments]
        # In another directory, as Python takes modules from that first.
        self.process = subprocess.Popen(
            command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=os.environ | own, cwd="/"
        )
        self.line = self.read_until(ready)

    def read_until(self, words: str) -> str:
        """Read what it says until a line with some words, and return that."""
        assert self.process.stderr is not None
        told = []
        for line in self.process.stderr:
            told.append(line)
            if words in line:
                return line.strip()
        raise AssertionError(f"it ended with {self.process.wait()} before it said {words!r}: {''.join(told[-10:])}")

    def kill(self) -> None:
        """End it without a word, as the kernel does when memory runs out."""
        assert self.process.stderr is not None
        self.process.kill()
        self.process.wait()
        self.process.stderr.close()


class Cluster:
    """A scheduler with workers of one thread each."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self.scheduler = DaskProcess(["scheduler", "--port", "0", *_QUIET], "Scheduler at:")
        self.address = self.scheduler.line.rpartition(" ")[2]
        self.workers: list[DaskProcess] = []

    def add_worker(self, environment: Mapping[str, str] | None = None) -> DaskProcess:
        """Start a worker and return when the scheduler knows it."""
        arguments = ["worker", self.address, "--nthreads", "1", "--no-nanny", "--local-directory", str(self._directory), *_QUIET]
        worker = DaskProcess(arguments, "Starting established connection", environment)
        self.workers.append(worker)
        return worker

    def end_workers(self) -> None:
        """End all workers and return when the scheduler has missed them, too."""
        for worker in self.workers:
            worker.kill()
        for _ in self.workers:
            self.scheduler.read_until("Remove worker")
        self.workers.clear()

    def end(self) -> None:
        """End all that still runs."""
        for one in (*self.workers, self.scheduler):
            one.kill()


@contextmanager
def dask_cluster(directory: Path, workers: int) -> Iterator[Cluster]:
    """A cluster with so many workers; ended when the context is left."""
    cluster = Cluster(directory)
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.end()


def square(number: int) -> int:
    """A task."""
    return number * number


def where(_number: int) -> int:
    """The process that does the task."""
    return os.getpid()


def wait_to_be_killed(directory: Path, number: int) -> int:
    """A task; the first time that it is done for 0, it writes the process's id into the directory and waits for its end."""
    mark = directory / "pid"
    if number == 0 and not mark.exists():
        draft = directory / "draft"
        draft.write_text(str(os.getpid()))
        draft.rename(mark)
        while True:
            signal.pause()
    return number * number


def fail(number: int) -> int:
    """A task that kills each worker that does it."""
    os.kill(os.getpid(), signal.SIGKILL)
    return number
