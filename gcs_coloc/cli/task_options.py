"""Options of every command that has tasks, their progress, and the console for their results."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress as ProgressBars

from gcs_coloc.core.errors import UsageError
from gcs_coloc.runtime.tasks import KeptResults, Progress, Workers

JobsOption = Annotated[int, typer.Option(help="Processes; 0 is one per core.", min=0)]
SchedulerOption = Annotated[
    str | None, typer.Option(help="Compute on the cluster of this Dask scheduler instead.", metavar="tcp://HOST:PORT")
]
ResumeOption = Annotated[
    Path | None, typer.Option(help="Keep the result of each task there; a run that was stopped goes on there.", metavar="DIR")
]


def kept_in(directory: Path | None) -> KeptResults | None:
    """Return where results are kept; None where the option is not used.

    Raises:
        UsageError: the directory cannot be used.
    """
    return KeptResults(directory) if directory is not None else None


def workers_for(jobs: int, scheduler: str | None) -> Workers:
    """Return where tasks run.

    Raises:
        UsageError: both options are used.
    """
    if jobs and scheduler is not None:
        raise UsageError("--jobs and --scheduler exclude each other: a cluster has the processes that its workers have")
    return Workers(jobs or os.cpu_count() or 1, scheduler)


@contextmanager
def progress_of(what: str) -> Iterator[Progress]:
    """Show how far some work is; call what is yielded with how much of how much is done."""
    # On stderr: stdout is for the result.
    with ProgressBars(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bars:
        task = bars.add_task(what, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


def result_console(file_width: int = 140) -> Console:
    """The console for tables; in a file or pipe they are `file_width` characters wide."""
    console = Console()
    return console if console.is_terminal else Console(width=file_width)
