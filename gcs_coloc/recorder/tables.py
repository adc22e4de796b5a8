"""Strict reading of CSV tables of numbers: a malformed row is an error that names the file, the line and the column."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from gcs_coloc.core.errors import DataError


class Row:
    """One row of a table. Its readers raise DataError that names the place."""

    def __init__(self, path: Path, line: int, cells: dict[str, str]) -> None:
        self._path, self._line, self._cells = path, line, cells

    def number(self, column: str) -> float:
        """A finite number."""
        text = self._cells[column]
        try:
            value = float(text)
        except ValueError:
            raise self.error(column, f"{text!r} is not a number") from None
        if not math.isfinite(value):
            raise self.error(column, f"{text} is not a finite number")
        return value

    def positive(self, column: str) -> float:
        """A finite number above zero."""
        value = self.number(column)
        if value <= 0.0:
            raise self.error(column, f"{self._cells[column]} must be above zero")
        return value

    def number_or_none(self, column: str) -> float | None:
        """A finite number, or None where the column is absent or the cell empty."""
        return self.number(column) if self._cells.get(column) else None

    def integer(self, column: str, least: int, most: int) -> int:
        """A whole number from `least` to `most`."""
        text = self._cells[column]
        try:
            value = int(text)
        except ValueError:
            raise self.error(column, f"{text!r} is not a whole number") from None
        if not least <= value <= most:
            raise self.error(column, f"{value} is not within {least} to {most}")
        return value

    def text(self, column: str) -> str:
        """The cell as it stands."""
        return self._cells[column]

    def error(self, column: str, problem: str) -> DataError:
        """An error at this row's place, to be raised by the caller."""
        return DataError(f"{self._path}: line {self._line}, column {column}: {problem}")


def read_table(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> Iterator[Row]:
    """The rows of a CSV file with a header line, in order; blank lines are passed over.

    Args:
        path: the file.
        required: columns that must be there, in any order.
        optional: columns that may be there. Others are ignored.

    Raises:
        DataError: the file cannot be read, a required column is missing, or a row has not as many cells as the header.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            yield from _rows(path, csv.reader(file, strict=True), required, optional)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is not a text file in UTF-8") from None
    except csv.Error as error:
        raise DataError(f"{path}: is not a CSV file: {error}") from None


def _rows(path: Path, reader: Iterator[list[str]], required: Sequence[str], optional: Sequence[str]) -> Iterator[Row]:
    header = [name.strip() for name in next(reader, [])]
    missing = [name for name in required if name not in header]
    if missing:
        raise DataError(f"{path}: line 1: column {missing[0]} is missing; wanted are {','.join((*required, *optional))}")
    for line, cells in enumerate(reader, start=2):
        if not cells:
            continue
        if len(cells) != len(header):
            raise DataError(f"{path}: line {line}: {len(cells)} cells where the header has {len(header)}")
        yield Row(path, line, {name: cell.strip() for name, cell in zip(header, cells, strict=True)})
