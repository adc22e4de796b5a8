from pathlib import Path

import pytest

from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.recorder.judged_flight import find_recordings


def make(directory: Path, *names: str) -> Path:
    for name in names:
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return directory


def test_every_recording_below_is_found_with_its_tables(tmp_path: Path) -> None:
    year = make(tmp_path / "year", "may/1/flight.tlog", "may/1/truth.csv", "may/1/ranges.csv", "june.tlog")

    june, may = find_recordings([year])

    assert (june.name, june.ranges, june.truth) == ("year/june.tlog", None, None)
    assert (may.name, may.file) == ("year/may/1/flight.tlog", year / "may/1/flight.tlog")
    assert (may.ranges, may.truth) == (year / "may/1/ranges.csv", year / "may/1/truth.csv")


def test_of_several_recordings_in_a_directory_each_has_tables_of_its_own(tmp_path: Path) -> None:
    make(tmp_path / "d", "a.tlog", "a.truth.csv", "b.tlog", "truth.csv", "ranges.csv")

    a, b = find_recordings([tmp_path / "d"])

    assert (a.truth, a.ranges) == (tmp_path / "d/a.truth.csv", None)
    assert (b.truth, b.ranges) == (None, None)


def test_names_do_not_depend_on_where_a_directory_is_and_digests_are_of_all_files(tmp_path: Path) -> None:
    first, second = (make(tmp_path / place / "year", "flight.tlog", "truth.csv") for place in ("here", "there"))
    assert [(r.name, r.digest) for r in find_recordings([first])] == [(r.name, r.digest) for r in find_recordings([second])]

    (second / "truth.csv").write_text("another")
    assert find_recordings([first])[0].digest != find_recordings([second])[0].digest
    (second / "truth.csv").unlink()
    assert find_recordings([first])[0].digest != find_recordings([second])[0].digest


def test_a_directory_that_is_stated_twice_is_judged_once(tmp_path: Path) -> None:
    make(tmp_path / "d", "a.tlog")
    assert len(find_recordings([tmp_path / "d", tmp_path / "d"])) == 1


def test_what_cannot_be_judged_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is no directory"):
        find_recordings([tmp_path / "missing"])
    with pytest.raises(DataError, match="no recording"):
        find_recordings([tmp_path])
    directories = [make(tmp_path / place / "year", "flight.tlog") for place in ("here", "there")]
    with pytest.raises(UsageError, match=r"would both be year/flight.tlog"):
        find_recordings(directories)
