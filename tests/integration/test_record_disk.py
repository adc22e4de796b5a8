"""A recording whose disk fails in flight and comes back: told once, nothing useless left behind, and whole files."""

from __future__ import annotations

import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from brokers import wait_until
from mcap.reader import make_reader
from vehicles import Hover, fly, square_fleet

from gcs_coloc.recorder.tlog import TlogReader

pytestmark = pytest.mark.integration

PATIENCE_S = 60.0


@dataclass
class Recorded:
    """The service in a process of its own, the directory it records in, and what it logs."""

    service: subprocess.Popen[str]
    directory: Path
    log: list[str]
    fleet: list[Hover]

    def fly_until(self, told: str, times: int = 1) -> None:
        fly(self.fleet, PATIENCE_S, until=lambda: self.count(told) >= times)
        assert self.count(told) == times, self.log

    def count(self, told: str) -> int:
        return sum(re.search(told, line) is not None for line in self.log)

    def end(self) -> None:
        self.service.send_signal(signal.SIGTERM)
        assert self.service.wait(PATIENCE_S) == 0


@pytest.fixture
def recorded(free_port, tmp_path) -> Iterator[Recorded]:
    directory, log = tmp_path / "flights", []
    command = [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{free_port}", "--record", str(directory), "--no-web"]
    service = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    reader = threading.Thread(target=lambda: [log.append(line) for line in service.stderr])  # a pipe: a file would be full, too
    reader.start()
    try:
        wait_until(lambda: any("listening on" in line for line in log))
        with square_fleet(free_port) as fleet:
            yield Recorded(service, directory, log, fleet)
    finally:
        service.kill()
        service.wait()
        reader.join()
        service.stderr.close()


def of_both(directory: Path, is_so: Callable[[Path], bool]) -> bool:
    """Whether it is so of the one tlog and the one MCAP file in the directory."""
    return all(len(paths := list(directory.glob(f"*.{ending}"))) == 1 and is_so(paths[0]) for ending in ("tlog", "mcap"))


def assert_whole(directory: Path) -> None:
    for path in directory.glob("*.tlog"):
        log = TlogReader(path)
        assert list(log)
        assert dict(log.counts) == {}
    for path in directory.glob("*.mcap"):
        with path.open("rb") as file:
            assert list(make_reader(file).iter_messages(log_time_order=False))


def test_a_full_disk_is_told_once_and_leaves_no_empty_files_and_the_recording_goes_on_once_there_is_room(recorded):
    """RLIMIT_FSIZE 0: as on a full disk new files can be made, and nothing can be written to any."""
    fly(recorded.fleet, PATIENCE_S, until=lambda: of_both(recorded.directory, lambda path: path.stat().st_size > 0))
    before = sorted(path.name for path in recorded.directory.iterdir())
    _, most = resource.prlimit(recorded.service.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(recorded.service.pid, resource.RLIMIT_FSIZE, (0, most))
    recorded.fly_until("nothing is being recorded: .*File too large; the flight goes on, and it is tried again every 5 s")
    fly(recorded.fleet, 12.0)  # two tries at least
    resource.prlimit(recorded.service.pid, resource.RLIMIT_FSIZE, (most, most))
    recorded.fly_until("recording again; 0 frames and entries were lost")
    recorded.end()
    assert recorded.count("nothing is being recorded") == recorded.count("recording again") == 1
    assert recorded.count("too slow") == 0
    after = sorted(path.name for path in recorded.directory.iterdir())
    assert after == sorted(before + [name.replace("-001.", "-002.") for name in before])
    assert_whole(recorded.directory)


def test_a_directory_that_is_taken_away_is_told_and_recorded_in_again_when_it_is_back(recorded):
    fly(recorded.fleet, PATIENCE_S, until=lambda: of_both(recorded.directory, lambda path: path.stat().st_size > 0))
    shutil.rmtree(recorded.directory)
    recorded.fly_until("nothing is being recorded: .*flights: the directory, or a file in it, was taken away; put .* back")
    recorded.directory.mkdir()
    recorded.fly_until("recording again; ")
    recorded.end()
    assert of_both(recorded.directory, lambda path: path.stat().st_size > 0)
    assert_whole(recorded.directory)
