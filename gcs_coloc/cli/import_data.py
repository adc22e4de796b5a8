"""`gcs-coloc import`: data of other formats as data sets."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.core.reasons import counted

_MOST_NAMED = 3  # chosen: one line of a terminal

app = typer.Typer(name="import", add_completion=False, help="Bring data of another format into the data-set layout.")


@app.callback()
def formats() -> None:
    """Bring data of another format into the data-set layout."""


@app.command("pyfg")
def pyfg(
    file: Annotated[Path, typer.Argument(help="A factor graph in PyFG's text format.", metavar="FILE")],
    directory: Annotated[Path, typer.Argument(help="Directory of the data set; it is made.", metavar="DIR")],
    denied: Annotated[
        list[str] | None, typer.Option(help="A robot to be located; several times for several; the first one by default.")
    ] = None,
    peer_sigma: Annotated[
        float, typer.Option(min=1e-3, help="Noise of the positions that the other robots report, m, per axis.")
    ] = 0.5,
    seed: Annotated[int, typer.Option(help="Seed of that noise.", min=0)] = 1,
) -> None:
    """Import a range-aided factor graph (PyFG).

    Its vertices are the truth, its landmarks the anchors, its range edges the ranges.
    """
    from gcs_coloc.evaluation.pyfg import import_pyfg

    found = import_pyfg(file, directory, denied or (), peer_sigma, seed)
    if found.dropped:
        first = "; ".join(found.dropped[:_MOST_NAMED])
        print(f"gcs-coloc: warning: {len(found.dropped)} lines are wrong and left out: {first}", file=sys.stderr)
    nodes = f"{', '.join(found.denied)} denied, {counted(len(found.peers), 'peer')}, {counted(found.anchors, 'anchor')}"
    print(f"written: {directory}: {nodes}, {found.ranges} ranges")
    print(f"next: gcs-coloc evaluate {directory}")
