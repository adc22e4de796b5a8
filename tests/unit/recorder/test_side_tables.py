"""Strict tables: every malformed row is an error that names file, line and column."""

from pathlib import Path

import pytest

from gcs_coloc.core.errors import DataError
from gcs_coloc.evaluation.tables import read_table


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "t.csv"
    path.write_text(text)
    return path


def test_reads_numbers_by_name_in_any_order_and_ignores_other_columns(tmp_path):
    rows = list(read_table(written(tmp_path, "b, x,a\n2,z,1\n\n4,z,3\n"), ["a", "b"]))
    assert [(r.number("a"), r.positive("b"), r.integer("a", 0, 9), r.text("b")) for r in rows] == [(1, 2, 1, "2"), (3, 4, 3, "4")]
    assert rows[0].is_empty("c")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1: column a is missing"),
        ("b\n1\n", "line 1: column a is missing"),
        ("a,b\n1,2\n1\n", "line 3, column 2: 1 cells where the header has 2"),
        ('a\n"1\n', "not a CSV file"),
        ("a;b\n1,5;2\n", "line 1: its columns are separated by semicolons; write commas, and points in numbers"),
        ("a\tb\n1\t2\n", "line 1: its columns are separated by tabs"),
    ],
)
def test_malformed_tables(tmp_path, text, words):
    with pytest.raises(DataError, match=words):
        list(read_table(written(tmp_path, text), ["a"]))


def test_what_spreadsheets_put_into_a_table_is_read(tmp_path):
    path = tmp_path / "t.csv"
    path.write_bytes(b"\xef\xbb\xbfa,b\r\n1,2\r\n")
    assert [(row.number("a"), row.number("b")) for row in read_table(path, ["a", "b"])] == [(1.0, 2.0)]


@pytest.mark.parametrize(
    ("cell", "read", "words"),
    [
        ("x", "number", "line 2, column 1 .a.: 'x' is not a number"),
        ("nan", "number", "line 2, column 1 .a.: 'nan' is not a finite number"),
        ("-1", "positive", "line 2, column 1 .a.: -1 has to be above 0"),
    ],
)
def test_malformed_cells(tmp_path, cell, read, words):
    row = next(read_table(written(tmp_path, f"a\n{cell}\n"), ["a"]))
    with pytest.raises(DataError, match=words):
        getattr(row, read)("a")


@pytest.mark.parametrize(("cell", "words"), [("1.5", "not a whole number"), ("256", "not within 1 to 255")])
def test_integers_are_checked(tmp_path, cell, words):
    with pytest.raises(DataError, match=words):
        next(read_table(written(tmp_path, f"a\n{cell}\n"), ["a"])).integer("a", 1, 255)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(DataError, match="cannot be read"):
        list(read_table(tmp_path / "absent.csv", ["a"]))
    binary = tmp_path / "b.csv"
    binary.write_bytes(b"a\n\xff\xfe\n")
    with pytest.raises(DataError, match="UTF-8"):
        list(read_table(binary, ["a"]))
