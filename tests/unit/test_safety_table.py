"""Every hazard in the tables of docs/reference/hazards.md names tests that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HAZARDS = (ROOT / "docs/reference/hazards.md").read_text(encoding="utf-8")


def rows() -> list[list[str]]:
    tables = [table.split("\n\n")[0] for table in HAZARDS.split("| hazard |")[1:]]
    return [[cell.strip() for cell in line.strip("|").split("|")] for table in tables for line in table.splitlines()[2:]]


def test_the_tables_have_their_rows_and_columns():
    assert len(rows()) >= 50
    assert {len(row) for row in rows()} == {4}
    assert all(cell for row in rows() for cell in row)


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_each_hazard_names_tests_that_exist(row):
    paths = re.findall(r"`(tests/[^`]+)`", row[3])
    assert paths
    for path in paths:
        file = ROOT / path
        assert file.is_file(), f"{path} does not exist"
        assert re.search(r"^def test_", file.read_text(encoding="utf-8"), re.MULTILINE), f"{path} holds no test"
