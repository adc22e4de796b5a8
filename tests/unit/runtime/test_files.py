"""Where results cannot be written, the option, the path and the remedy are named."""

from pathlib import Path

import pytest

from gcs_coloc.core.errors import UsageError
from gcs_coloc.runtime.files import check_output_file, make_output_directory, writing


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("here", "it is a directory; state a file in it"),
        ("absent/x.csv", "there is no directory .*absent; make it first"),
        ("file/x.csv", "file is a file and no directory"),
    ],
)
def test_a_file_that_cannot_be_made_is_refused(tmp_path, name, words):
    (tmp_path / "here").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=f"--out .*{name}: cannot be written: .*{words}"):
        check_output_file(tmp_path / name, "--out")


def test_a_file_that_can_be_made_or_written_over_is_right_and_is_not_made(tmp_path):
    (tmp_path / "file").write_text("before")
    for path in (None, tmp_path / "new", tmp_path / "file"):
        check_output_file(path, "--out")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "before"


def test_a_directory_is_made_and_a_file_is_none(tmp_path):
    for _ in range(2):
        make_output_directory(tmp_path / "a" / "b", "--out")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()
    for name, words in (("file", "it is a file; state a directory"), ("file/below", "Not a directory")):
        with pytest.raises(UsageError, match=f"--out .*{name}: cannot be written to: {words}"):
            make_output_directory(tmp_path / name, "--out")


def test_what_the_system_says_of_a_file_names_it_and_the_option(tmp_path):
    words = r"--csv /proc/no_such_entry\.csv: cannot be written: No such file or directory"
    with pytest.raises(UsageError, match=words), writing(Path("/proc/no_such_entry.csv"), "--csv"):
        Path("/proc/no_such_entry.csv").write_text("x")
    with pytest.raises(UsageError, match=r"^.*full: cannot be written: No space left"), writing(tmp_path / "full", ""):
        Path("/dev/full").write_text("x")
