"""Options of every command that has tasks: where they run and where results are kept."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.core.errors import UsageError
from gcs_coloc.runtime.tasks import KeptResults, Workers

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
