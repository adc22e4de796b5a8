"""Every hazard in the table of safety.md names tests that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SAFETY = (ROOT / "docs/explanation/safety.md").read_text(encoding="utf-8")


def rows() -> list[list[str]]:
    table = SAFETY[SAFETY.index("| hazard |") :].split("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_the_table_has_its_rows_and_columns():
    assert len(rows()) >= 30
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
