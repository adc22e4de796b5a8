"""Reading of CSV tables.

A row that is wrong is an error, or is dropped, with the file, the line and the column.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar

from gcs_coloc.core.errors import DataError
from gcs_coloc.runtime.files import reading

_OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs"}
_MOST_DROPPED = 0.5
"""Share of a file's rows that may be dropped; chosen: a file of which most is wrong is another file than it is taken for."""
_MOST_NAMED = 3  # chosen: one line of a terminal

Parsed = TypeVar("Parsed")


@dataclass(frozen=True, slots=True)
class DroppedRows:
    """Rows of one file that were dropped because something in them is wrong.

    How many of how many, and where the first are.
    """

    path: Path
    count: int
    rows: int
    first: tuple[str, ...]


class TableRow:
    """One row of a table. Its readers raise DataError that names the place."""

    def __init__(self, path: Path, line: int, header: list[str], cells: list[str]) -> None:
        self._path, self._line, self._header, self._cells = path, line, header, cells

    def check_length(self) -> None:
        """Raise if the row has not as many cells as the header."""
        if len(self._cells) != len(self._header):
            column = min(len(self._cells), len(self._header)) + 1
            problem = f"{len(self._cells)} cells where the header has {len(self._header)}"
            raise DataError(f"{self._path}, line {self._line}, column {column}: {problem}")

    def has(self, column: str) -> bool:
        """Whether the table has an optional column."""
        return column in self._header

    def text(self, column: str) -> str:
        """Return the text of a cell, without blanks around it."""
        return self._cells[self._header.index(column)].strip()

    def number(self, column: str) -> float:
        """Return the finite number in a cell."""
        text = self.text(column)
        try:
            value = float(text)
        except ValueError:
            raise self.error(column, f"{text!r} is not a number") from None
        if not math.isfinite(value):
            raise self.error(column, f"{text!r} is not a finite number")
        return value

    def positive(self, column: str) -> float:
        """Return the finite number above zero in a cell."""
        value = self.number(column)
        if value <= 0.0:
            raise self.error(column, f"{value:g} has to be above 0")
        return value

    def not_negative(self, column: str) -> float:
        """Return the finite number not below zero in a cell."""
        value = self.number(column)
        if value < 0.0:
            raise self.error(column, f"{value:g} must not be negative")
        return value

    def within(self, column: str, least: float, most: float, what: str) -> float:
        """Return the finite number from `least` to `most` in a cell.

        `what` says in the error what it would have to be.
        """
        value = self.number(column)
        if not least <= value <= most:
            raise self.error(column, f"{value:g} is not within {least:g} to {most:g}: {what}")
        return value

    def is_empty(self, column: str) -> bool:
        """Whether the column is absent or the cell empty."""
        return not self.has(column) or not self.text(column)

    def integer(self, column: str, least: int, most: int) -> int:
        """Return the whole number from `least` to `most` in a cell."""
        text = self.text(column)
        try:
            value = int(text)
        except ValueError:
            raise self.error(column, f"{text!r} is not a whole number") from None
        if not least <= value <= most:
            raise self.error(column, f"{value} is not within {least} to {most}")
        return value

    def error(self, column: str, problem: str) -> DataError:
        """Return an error at this row's place, to be raised by the caller."""
        return DataError(f"{self._path}, line {self._line}, column {self._header.index(column) + 1} ({column}): {problem}")


def read_table(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> Iterator[TableRow]:
    """Yield the rows of a CSV file with a header line, in order.

    Blank lines are passed over, other columns ignored.

    Args:
        path: the file.
        required: columns that must be there, in any order.
        optional: columns that may be there.

    Raises:
        DataError: the file cannot be read, a required column is missing, an optional one is called nearly so, or a row has not as
            many cells as the header.
    """

    def check(header: list[str]) -> None:
        missing = [name for name in required if name not in header]
        # A column of nearly that name would be passed over in silence, and a default stand in its place.
        meant = {
            name: get_close_matches(name, set(header) - {*required, *optional}, 1) for name in optional if name not in header
        }
        meant = {name: near for name, near in meant.items() if near}
        if missing or meant:
            name, near = (missing[0], []) if missing else next(iter(meant.items()))
            there = f", but {near[0]!r} is there" if near else ""
            wanted = ",".join((*required, *optional))
            raise DataError(f"{path}, line 1: column {name} is missing{there}; wanted are {wanted}")

    for row in _read(path, check):
        row.check_length()
        yield row


def read_layout(
    path: Path, parse: Callable[[TableRow], Parsed], required: Sequence[str], *optional: Sequence[str]
) -> tuple[list[Parsed], DroppedRows]:
    """Parse the rows of a file with required columns, then any of the optional groups.

    In that order and no other.

    A row for which `parse` raises DataError is dropped.

    Raises:
        DataError: as `read_table`, a column is where none of that name belongs, or more than half of the rows are wrong.
    """

    def check(header: list[str]) -> None:
        expected = list(required)
        for group in optional:
            if header[len(expected) : len(expected) + len(group)] == list(group):
                expected += group
        if header == expected:
            return
        place = next(
            (i for i, (a, b) in enumerate(zip(header, expected, strict=False)) if a != b), min(len(header), len(expected))
        )
        layout = ",".join(required) + "".join(f"[,{','.join(group)}]" for group in optional)
        there = f"{header[place]!r} stands there" if place < len(header) else "nothing stands there"
        raise DataError(f"{path}, line 1, column {place + 1}: {there}; the header has to be {layout}")

    parsed: list[Parsed] = []
    wrong: list[str] = []
    for row in _read(path, check):
        try:
            row.check_length()
            parsed.append(parse(row))
        except DataError as error:
            wrong.append(str(error))
    count = len(parsed) + len(wrong)
    if len(wrong) > _MOST_DROPPED * count:
        others = f" ({len(wrong)} of {count} rows are wrong)" if count > 1 else ""
        raise DataError(wrong[0] + others)
    return parsed, DroppedRows(path, len(wrong), count, tuple(wrong[:_MOST_NAMED]))


def _read(path: Path, check_header: Callable[[list[str]], None]) -> Iterator[TableRow]:
    try:
        with (
            reading(path),
            path.open(encoding="utf-8-sig", newline="") as file,
        ):  # spreadsheets begin UTF-8 with a byte order mark
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            other = next((sign for sign in _OTHER_SEPARATORS if len(header) == 1 and sign in header[0]), None)
            if other is not None:
                what = _OTHER_SEPARATORS[other]
                raise DataError(f"{path}, line 1: its columns are separated by {what}; write commas, and points in numbers")
            twice = next((name for i, name in enumerate(header) if name in header[:i]), None)
            if twice is not None:
                raise DataError(f"{path}, line 1, column {header.index(twice) + 1}: two columns are called {twice!r}")
            check_header(header)
            for cells in reader:
                if not cells:
                    continue
                yield TableRow(path, reader.line_num, header, cells)
    except csv.Error as error:
        raise DataError(f"{path}: is not a CSV file: {error}") from None
