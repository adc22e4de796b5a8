"""Flights of real autopilots: the paths of their simulators come from outside, and the figures of all flights make one table."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from flight_figures import HEADER, Figures, judge
from four_ship import Case, FourShip

Flown = Callable[[Case], tuple[FourShip, list[Figures]]]

_ROWS = pytest.StashKey[list[Figures]]()
_VARIABLES = {
    "arduplane": "SITL_ARDUPLANE",
    "arducopter": "SITL_ARDUCOPTER",
    "ardurover": "SITL_ARDUROVER",
    "px4": "SITL_PX4",
}


def pytest_configure(config: pytest.Config) -> None:
    """An empty table."""
    config.stash[_ROWS] = []


@pytest.fixture
def program(request: pytest.FixtureRequest) -> Path:
    """The path of the simulator that a test module is about (`AUTOPILOT`); the test is skipped where none is given."""
    variable = _VARIABLES[request.module.AUTOPILOT]
    path = os.environ.get(variable, "")
    if not path:
        pytest.skip(f"{variable} names no simulator (docs/how-to/fly-real-autopilots.md)")
    if not os.access(path, os.X_OK):
        pytest.fail(f"{variable}={path}: no program there", pytrace=False)
    return Path(path)


@pytest.fixture
def flight_directory(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Where a flight leaves its recording, truth and logs: below SITL_FLIGHTS if that is set, else a temporary directory."""
    kept = os.environ.get("SITL_FLIGHTS", "")
    if not kept:
        return tmp_path
    directory = Path(kept) / f"{request.module.__name__.rpartition('.')[2]}-{request.node.name}"
    shutil.rmtree(directory, ignore_errors=True)
    return directory


@pytest.fixture
def flown(
    request: pytest.FixtureRequest, program: Path, flight_directory: Path
) -> Callable[[Case], tuple[FourShip, list[Figures]]]:
    """Flies a case as the test's module says (`FLOWN_AS`), judges its denied vehicles and adds them to the table."""

    def fly_case(case: Case) -> tuple[FourShip, list[Figures]]:
        how = request.module.FLOWN_AS
        ship = how.fly(case, program, flight_directory)
        rows = []
        for sysid in case.denied:
            which = f" ({sysid})" if len(case.denied) > 1 else ""
            rows.append(judge(ship, sysid, how.announced_delay_s, f"{request.module.AUTOPILOT} {case.name}{which}"))
        request.config.stash[_ROWS].extend(rows)
        return ship, rows

    return fly_case


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the one table."""
    if rows := config.stash[_ROWS]:
        terminalreporter.write_line("\n" + "\n".join([HEADER, *(figures.row() for figures in rows)]))
