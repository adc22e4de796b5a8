"""Drawing with matplotlib, which is an extra: figures in memory, written as files without a screen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gcs_coloc.core.errors import UsageError


def new_figure(size: tuple[float, float]) -> Any:
    """Return an empty figure of a size in inches.

    Raises:
        UsageError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError('drawing needs matplotlib: pip install "gcs-coloc[plots]"') from error
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Any, path: Path | str, dpi: int = 110) -> None:
    """Write a figure; the file's ending sets the format.

    Raises:
        UsageError: the ending is not one that matplotlib writes, or the file cannot be written.
    """
    try:
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error
