"""Two fleets in worker processes under one supervisor, on real UDP sockets: deaths, ends, logs, metrics and the page."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from vehicles import Hover, fly, square_fleet

from bench.free_ports import free_port, free_ports
from bench.two_links import COMPONENT_IDS, two_links

pytestmark = pytest.mark.integration

PATIENCE_S = 60.0
_GAP_S = 0.5
"""Five periods of GPS_INPUT, as for a take-over of the hot standby: a busy machine delays one, a dead sender all."""


class Supervised:
    """The supervisor with its log, and a square fleet of hovering vehicles at each worker, of which 4 has no GPS."""

    def __init__(self, process: subprocess.Popen[str], north: list[Hover], south: list[Hover], page: str) -> None:
        self.process, self.fleets, self.page = process, {"north": north, "south": south}, page
        self.lines: list[str] = []
        self.reading = threading.Thread(target=self._read, daemon=True)
        self.reading.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        self.lines += self.process.stderr  # type: ignore[arg-type]

    @property
    def log(self) -> str:
        return "".join(self.lines)

    def worker(self, name: str) -> int:
        """The newest process of a fleet, by what the supervisor logged; 0 before the first."""
        found = re.findall(rf"fleet {name}: process (\d+)", self.log)
        return int(found[-1]) if found else 0

    def fly(self, until: Callable[[], bool] = lambda: False, seconds: float = PATIENCE_S, failed: tuple[int, ...] = (4,)) -> bool:
        with ThreadPoolExecutor(2) as pilots:
            list(pilots.map(lambda fleet: fly(fleet, seconds, failed=failed, until=until), self.fleets.values()))
        return until()

    def aids(self, name: str) -> list[tuple[float, int]]:
        """When a fleet's vehicle 4 got GPS_INPUT, and of which fix type."""
        return [(at_s, m.fix_type) for at_s, m in self.fleets[name][3].received if m.get_type() == "GPS_INPUT"]

    def fixed_since(self, name: str, since_s: float) -> bool:
        return any(at_s > since_s and fix_type == 3 for at_s, fix_type in self.aids(name))

    def get(self, path: str) -> tuple[int, str]:
        try:
            with urllib.request.urlopen(self.page + path, timeout=5.0) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()
        except OSError as error:
            return 0, str(error)


@pytest.fixture
def supervised(tmp_path) -> Iterator[Supervised]:
    north, south = free_ports(2)
    page = free_port(socket.SOCK_STREAM)
    config = tmp_path / "fleets.toml"
    config.write_text(
        f'[service]\nprocesses = "per-fleet"\naddress = "127.0.0.1:{page}"\n'
        f'[record]\ndirectory = "{tmp_path / "flights"}"\n'
        "[aiding]\nalert_limit_m = 60\n"
        + "".join(f'[[fleet]]\nname = "{n}"\nlinks = ["udpin:127.0.0.1:{p}"]\n' for n, p in (("north", north), ("south", south)))
    )
    command = [sys.executable, "-m", "gcs_coloc", "--config", str(config)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    with square_fleet(north) as fleet, square_fleet(south) as other:
        found = Supervised(process, fleet, other, f"http://127.0.0.1:{page}/")
        yield found
        for pid in {process.pid, found.worker("north"), found.worker("south")} - {0}:
            with contextlib.suppress(ProcessLookupError):
                if pid == process.pid or is_ours(pid):
                    os.kill(pid, signal.SIGKILL)
        process.wait()
        found.reading.join(10.0)
        process.stderr.close()


def is_ours(pid: int) -> bool:
    """Whether a worker still runs under this number."""
    with contextlib.suppress(OSError):
        return b"--supervisor" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def aided(supervised: Supervised) -> None:
    """Both fleets have lost the GPS of their vehicle 4, and get fixes."""
    listening = lambda: supervised.log.count("listening on") == 2  # noqa: E731
    assert supervised.fly(listening, failed=()), supervised.log
    supervised.fly(seconds=3.0, failed=())
    began_s = time.monotonic()
    assert supervised.fly(lambda: all(supervised.fixed_since(name, began_s) for name in supervised.fleets)), supervised.log


def samples(text: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    families = list(text_string_to_metric_families(text))
    assert len({family.name for family in families}) == len(families)
    return {(s.name, tuple(sorted(s.labels.items()))): s.value for family in families for s in family.samples}


def test_a_worker_that_is_killed_comes_back_and_the_other_ones_stream_has_no_gap(supervised, tmp_path):
    aided(supervised)
    first, south = supervised.worker("north"), supervised.worker("south")
    with (tmp_path / "fleets.toml").open("a") as config:
        config.write("a_mistake_in_the_table_of_south = 1\n")
    os.kill(first, signal.SIGKILL)
    killed_s = time.monotonic()
    assert supervised.fly(lambda: supervised.worker("north") != first and supervised.fixed_since("north", killed_s + 1.0)), (
        supervised.log
    )
    back_s = time.monotonic()
    assert supervised.worker("south") == south
    times = [at_s for at_s, fix_type in supervised.aids("south") if killed_s - 1.0 < at_s < back_s and fix_type == 3]
    assert max(b - a for a, b in itertools.pairwise(times)) < _GAP_S
    assert "ERROR fleet north: its process was ended by SIGKILL; it is started again in 0.1 s" in supervised.log


def test_sigterm_ends_both_in_order_and_each_line_of_the_log_names_its_fleet(supervised, tmp_path):
    aided(supervised)
    workers = [supervised.worker(name) for name in supervised.fleets]
    supervised.process.send_signal(signal.SIGTERM)
    asked_s = time.monotonic()
    assert supervised.fly(lambda: supervised.process.poll() is not None), supervised.log
    assert time.monotonic() - asked_s < 5.0  # systemd kills what has not ended by then
    assert supervised.process.returncode == 0
    assert not any(map(is_ours, workers))
    supervised.fly(seconds=0.5)
    assert [supervised.aids(name)[-1][1] for name in supervised.fleets] == [1, 1]
    recorded = tmp_path / "flights"
    assert all(list((recorded / name).glob("*.tlog")) for name in supervised.fleets)
    own = re.compile(r"^\S+ \S+ (INFO|WARNING|ERROR) (fleet )?(north|south): ")
    others = [line for line in supervised.lines if not own.match(line) and "page of all fleets: http" not in line]
    assert others == []
    assert "INFO north: aiding of vehicle 4 ended: the service ends" in supervised.log


def test_a_supervisor_that_is_killed_leaves_no_worker_and_its_vehicles_are_told(supervised):
    aided(supervised)
    workers = [supervised.worker(name) for name in supervised.fleets]
    supervised.process.kill()
    assert supervised.fly(lambda: not any(map(is_ours, workers))), supervised.log
    supervised.fly(seconds=0.5)
    assert [supervised.aids(name)[-1][1] for name in supervised.fleets] == [1, 1]
    assert supervised.log.count("the supervisor has gone: this fleet's process ends") == 2


def test_a_worker_that_hangs_is_told_of_and_killed_at_the_end(supervised):
    aided(supervised)
    north = supervised.worker("north")
    assert supervised.fly(lambda: supervised.get("readyz") == (200, "ok\n")), supervised.get("readyz")
    os.kill(north, signal.SIGSTOP)
    stopped_s = time.monotonic()
    assert supervised.fly(lambda: "ERROR fleet north: its process hangs: not heard for" in supervised.log), supervised.log
    status, text = supervised.get("readyz")
    assert (status, text.startswith("fleet north: not heard for")) == (503, True)
    found = samples(supervised.get("metrics")[1])  # without those of the one that hangs
    assert found["gcs_coloc_worker_up", (("fleet", "north"),)] == 0.0
    assert ("gcs_coloc_vehicles", (("fleet", "north"),)) not in found
    assert found["gcs_coloc_vehicles", (("fleet", "south"),)] == 4.0
    times = [at_s for at_s, fix_type in supervised.aids("south") if at_s > stopped_s - 1.0 and fix_type == 3]
    assert max(b - a for a, b in itertools.pairwise(times)) < _GAP_S
    supervised.process.send_signal(signal.SIGTERM)
    assert supervised.fly(lambda: supervised.process.poll() is not None), supervised.log
    assert not is_ours(north)
    assert "fleet north: its process does not end, and is killed" in supervised.log


def test_one_endpoint_has_the_metrics_of_both(supervised):
    aided(supervised)
    found: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {}

    def both_are_aided() -> bool:
        found.update(samples(supervised.get("metrics")[1]))
        fixes = [found.get(("gcs_coloc_vehicle_aiding_fix", (("fleet", n), ("sysid", "4")))) for n in supervised.fleets]
        return fixes == [1.0, 1.0]

    assert supervised.fly(both_are_aided), found
    for name in supervised.fleets:
        assert found["gcs_coloc_vehicles", (("fleet", name),)] == 4.0
        assert found["gcs_coloc_vehicle_link_frames_received_total", (("fleet", name), ("sysid", "1"))] > 0.0
        assert found["process_cpu_seconds_total", (("fleet", name),)] > 0.0
        assert found["gcs_coloc_worker_up", (("fleet", name),)] == 1.0
        assert found["gcs_coloc_worker_starts_total", (("fleet", name),)] == 1.0
    assert found["process_cpu_seconds_total", ()] > 0.0
    assert found["gcs_coloc_watch_fleets", (("presence", "live"),)] == 2.0


def test_a_fleet_whose_port_is_taken_is_tried_again_while_the_other_one_flies(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        ports = {"north": taken.getsockname()[1], "south": free_port()}
        tables = "".join(f'[[fleet]]\nname = "{name}"\nlinks = ["udpin:127.0.0.1:{port}"]\n' for name, port in ports.items())
        (tmp_path / "fleets.toml").write_text(f'[service]\nprocesses = "per-fleet"\n{tables}')
        command = [sys.executable, "-m", "gcs_coloc", "--config", str(tmp_path / "fleets.toml"), "--no-web"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            lines, wanted = [], {"south: listening on", "fleet north: its process ended with exit code 1", "north: listening on"}
            for line in process.stderr:
                lines.append(line)
                wanted -= {words for words in wanted if words in line}
                if wanted == {"north: listening on"}:
                    taken.close()
                if not wanted:
                    break
            assert not wanted, lines
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
            process.communicate()
    assert any(line.startswith("gcs-coloc: error: fleet north: ") for line in lines), lines
    assert not any("page" in line for line in lines)


def test_a_hot_standby_takes_over_from_a_worker_that_dies_and_the_one_that_returns_is_passive(tmp_path):
    first, second = COMPONENT_IDS
    logs = [tmp_path / "first.log", tmp_path / "second.log"]
    read = lambda: [log.read_text() if log.exists() else "" for log in logs]  # noqa: E731
    with contextlib.ExitStack() as stack:
        air, ports = stack.enter_context(two_links())
        for index, role in enumerate(("active", "standby")):
            config = tmp_path / f"{index}.toml"
            config.write_text(
                '[service]\nprocesses = "per-fleet"\n[aiding]\nalert_limit_m = 60\n[[fleet]]\nname = "north"\n'
                f'links = ["udpin:127.0.0.1:{ports[index]}"]\n[fleet.mavlink]\ncomponent_id = {COMPONENT_IDS[index]}\n'
                f'[fleet.standby]\npeer = "127.0.0.1:{air.sign_ports[1 - index]}"\n'
                f'listen = "127.0.0.1:{air.sign_ports[index]}"\nrole = "{role}"\n'
            )
            command = [sys.executable, "-m", "gcs_coloc", "--config", str(config), "--no-web"]
            with logs[index].open("wb") as log:
                process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)
            stack.callback(process.wait)
            stack.callback(process.terminate)
        healthy = "north: vehicle 4: GPS unknown -> healthy"
        assert air.fly(PATIENCE_S, lambda: all(healthy in log for log in read())), read()
        assert air.fly(PATIENCE_S, lambda: "north: hot standby: this service is active" in read()[0]), read()
        air.fly(3.0)
        air.lose_gps()
        assert air.fly(PATIENCE_S, lambda: air.has_fix_from(first)), read()
        air.fly(3.0)  # the second one has it located, too
        os.kill(int(re.findall(r"fleet north: process (\d+)", read()[0])[-1]), signal.SIGKILL)
        killed_s = time.monotonic()
        assert air.fly(PATIENCE_S, lambda: air.has_fix_from(second, killed_s)), read()
        # By a sign of life of the other one, or by a fix that a vehicle passes on: whichever it gets first.
        passive = "this service follows, and does not take over until it is told"
        assert air.fly(PATIENCE_S, lambda: passive in read()[0].partition("SIGKILL")[2]), read()
        since_s = time.monotonic()
        air.fly(2.0)
        assert {fed.compid for fed in air.aids(since_s)} == {second}
