"""The programs as a user starts them, in real time over loopback UDP: the fakes fly on what the service sends.

What an aircraft gains by it is measured on simulated time, in
tests/unit/study/test_closed_loop.py: a busy machine disturbs nothing there.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from sitl_fakes.scenario import SCENARIOS

pytestmark = pytest.mark.integration

LOST_S, ROWS = 5.0, 50
LIMIT_S = 100.0


def start_fakes(port: int, scenario: Path, truth: Path) -> subprocess.Popen[bytes]:
    flags = ["--target", f"127.0.0.1:{port}", "--seed", "11", "--truth", str(truth)]
    command = [sys.executable, "-m", "sitl_fakes", str(scenario), *flags]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def sources_without_gps(truth: Path) -> list[str]:
    """What vehicle 4 navigates on, from a while after its GPS was lost; whole lines of the file alone."""
    lines = truth.read_text(encoding="utf-8").splitlines(keepends=True) if truth.exists() else []
    rows = csv.DictReader(line for line in lines if line.endswith("\n"))
    return [row["source"] for row in rows if row["sysid"] == "4" and float(row["at_s"]) >= LOST_S + 1.0]


def waited_for(condition: Callable[[], bool]) -> bool:
    ends_s = time.monotonic() + LIMIT_S
    while not (met := condition()) and time.monotonic() < ends_s:
        time.sleep(0.5)
    return met


def test_the_aircraft_without_gps_flies_on_what_the_service_sends_and_reckons_on_without(start_service, free_port, tmp_path):
    scenario, with_service, without = tmp_path / "scenario.toml", tmp_path / "with.csv", tmp_path / "without.csv"
    text = (SCENARIOS / "uwb.toml").read_text(encoding="utf-8")
    assert "at_s = 20.0" in text
    scenario.write_text(text.replace("at_s = 20.0", f"at_s = {LOST_S}"), encoding="utf-8")
    start_service("--udp", f"127.0.0.1:{free_port}")
    fakes = [start_fakes(free_port, scenario, with_service), start_fakes(9, scenario, without)]  # port 9: nobody listens
    try:
        assert waited_for(lambda: sources_without_gps(with_service).count("gps2 injected") >= ROWS)
        assert waited_for(lambda: len(sources_without_gps(without)) >= ROWS)
        assert set(sources_without_gps(without)) == {"dead_reckoning"}
    finally:
        for process in fakes:
            process.kill()
            process.wait()
