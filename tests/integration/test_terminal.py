"""Thirty vehicles on a terminal of 80 columns and 24 lines, a real one: what an operator reads there, nothing cut."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from brokers import wait_until
from vehicles import COUNT, swarm

pytestmark = pytest.mark.integration

FAILED = 23
COLUMNS, LINES = 80, 24
LAST_LINE = re.compile(r"and \d+ more vehicles, all healthy")


@pytest.fixture
def terminal(tmp_path: Path, free_port: int) -> Iterator[Callable[[], list[str]]]:
    """The lines that tmux shows of a service that runs in it."""
    tmux = ["tmux", "-u", "-f", "/dev/null", "-S", str(tmp_path / "tmux")]
    service = shlex.join([sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{free_port}", "--no-web"])
    subprocess.run([*tmux, "new-session", "-d", "-x", str(COLUMNS), "-y", str(LINES), service], check=True)

    def shown() -> list[str]:
        return subprocess.run([*tmux, "capture-pane", "-p"], check=True, capture_output=True, text=True).stdout.splitlines()

    yield shown
    subprocess.run([*tmux, "kill-server"], check=True)


def test_the_most_serious_stands_first_with_its_reason_and_no_line_is_cut(terminal, free_port):
    failed: set[int] = set()
    with swarm(free_port, failed):
        wait_until(lambda: LAST_LINE.match(terminal()[-1]))
        failed.add(FAILED)
        lines: list[str] = []

        def shows_the_failure() -> bool:
            # A whole picture: while a line of the log moves the table up its end is not drawn yet.
            lines[:] = terminal()
            return LAST_LINE.match(lines[-1]) is not None and any(re.match(rf"{FAILED} +failed", line) for line in lines)

        wait_until(shows_the_failure)
    assert len(lines) <= LINES
    rows = [line for line in lines if re.match(r"\d+ +(failed|healthy)", line)]
    assert [int(row.split()[0]) for row in rows] == [FAILED, *(n for n in range(1, COUNT + 1) if n != FAILED)][: len(rows)]
    assert len(rows) > 10
    (reason,) = (line for line in lines if line.startswith(f"{FAILED}: "))
    assert "fix type 1" in reason
    assert not any("…" in line for line in lines)
    assert f"and {COUNT - len(rows)} more vehicles, all healthy" in lines
