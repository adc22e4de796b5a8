"""Standard streams that are closed, full, or no longer read: one line or none, never a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HELP = [sys.executable, "-m", "gcs_coloc", "--help"]
HELP_THAT_LOADS_ALL = [sys.executable, "-m", "gcs_coloc", "replay", "--help"]


@pytest.mark.parametrize(
    ("closed", "command"), [("<&-", HELP), (">&-", HELP), ("2>&-", HELP), ("<&- >&- 2>&-", HELP_THAT_LOADS_ALL)]
)
def test_a_program_that_is_started_with_closed_streams_does_its_work(closed, command):
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}', "sh", *command], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_what_is_opened_first_does_not_become_the_closed_output():
    code = "from gcs_coloc.runtime.process import open_all; open_all(); import os; print('x'); exit(os.open('/dev/zero', 0))"
    done = subprocess.run(["sh", "-c", 'exec "$@" >&- 2>&- <&-', "sh", sys.executable, "-c", code], timeout=60, check=False)
    assert done.returncode > 2


def test_a_reader_who_has_seen_enough_ends_the_output_without_a_word():
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(HELP, stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_full_disk_under_the_output_is_one_line():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(HELP, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr == "gcs-coloc: error: the output cannot be written: No space left on device\n"
