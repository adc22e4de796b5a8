"""Files that commands read and write, their errors, and the figures and tables of commands.

What is wrong with a file is told in one line that names it. The paths of outputs are checked before the work: a wrong one is
then reported at once and not after minutes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gcs_coloc.core.errors import DataError, GcsColocError, UsageError

if TYPE_CHECKING:
    from rich.table import Table


def check_output_file(path: Path | None, option: str) -> None:
    """Check that a file can be made there, or written over; None, where the option is not used, is right.

    Raises:
        UsageError: it is a directory, or its directory is missing.
    """
    if path is None:
        return
    if path.is_dir():
        raise UsageError(f"{option} {path}: cannot be written: it is a directory; state a file in it")
    if path.parent.exists() and not path.parent.is_dir():
        raise UsageError(f"{option} {path}: cannot be written: {path.parent} is a file and no directory")
    if not path.parent.exists():
        raise UsageError(f"{option} {path}: cannot be written: there is no directory {path.parent}; make it first")


@contextmanager
def reading(where: Path | str, error: type[GcsColocError] = DataError) -> Iterator[None]:
    """Read a file in this context; `error` is raised where that fails, its text begins with `where`."""
    try:
        yield
    except OSError as found:
        raise error(f"{where}: cannot be read: {found.strerror or found}") from None
    except UnicodeDecodeError:
        raise error(f"{where}: is not a text file in UTF-8") from None


@contextmanager
def writing(path: Path, option: str) -> Iterator[None]:
    """Write a file in this context; `option` is where the user stated it, empty where he did not.

    Raises:
        UsageError: the system does not let it be written.
    """
    try:
        yield
    except OSError as error:
        raise UsageError(f"{option} {error.filename or path}: cannot be written: {error.strerror or error}".lstrip()) from None


def make_output_directory(path: Path, option: str) -> None:
    """Make a directory where there is none.

    Raises:
        UsageError: it is a file, or may not be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise UsageError(f"{option} {path}: cannot be written to: it is a file; state a directory") from None
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be written to: {error.strerror}") from None


def new_table(*headings: str, left: Collection[str] = (), title: str | None = None) -> Table:
    """Return an empty table for the console; its columns are right-aligned but those of `left`."""
    from rich.table import Column, Table  # here: a service needs none

    return Table(*(Column(heading, justify="left" if heading in left else "right") for heading in headings), title=title)


def check_drawing() -> None:
    """Check that figures can be drawn. Raises UsageError where matplotlib is not installed."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise UsageError('drawing needs matplotlib: pip install "gcs-coloc[plots]"') from error


def new_figure(size: tuple[float, float]) -> Any:
    """Return an empty figure of a size in inches. Raises UsageError as `check_drawing`."""
    check_drawing()
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained")


def save_figure(figure: Any, path: Path | str, dpi: int = 110) -> None:
    """Write a figure; the file's ending sets the format.

    Raises:
        UsageError: the ending is not one that matplotlib writes, or the file cannot be written.
    """
    try:
        figure.savefig(path, dpi=dpi)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error
