"""Studies: CPU of a simulated flight hour, flight hours judged per core hour, and how tasks scale on a Dask cluster."""

from __future__ import annotations

import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from bench.figures import Figure
from gcs_coloc.config.fleets import load_settings
from gcs_coloc.recorder.judged_flight import JudgedBy, find_recordings, judge_flight
from gcs_coloc.runtime.tasks import Workers, run_tasks
from gcs_coloc.study.integrity.trial import fly_trial
from sitl_fakes.fleet import STEP_S, Fleet
from sitl_fakes.scenario import SCENARIOS, load_scenario

_FOUR = "three-peers"
"""The class of flights of four aircraft: one denied, three peers."""
_CPU_GOAL_S = 90.0
_SCALING_GOAL, _POOL_GOAL = 1.9, 0.95
_TASK_FLIGHT_S = 40.0
"""Flight of one task of the scaling runs: it takes a second or two."""
_UNIX_EPOCH_S = 1_780_000_000.0


def measure(quick: bool) -> list[Figure]:
    """CPU of flight hours, and scaling."""
    return [_study_cpu(120.0 if quick else 240.0, 1 if quick else 3), _judged(60.0 if quick else 300.0), *_scaling(quick)]


def _study_cpu(flight_s: float, flights: int) -> Figure:
    used = []
    for seed in range(1, flights + 1):
        began_s = time.process_time()
        fly_trial(_FOUR, seed, duration_s=flight_s)
        used.append((time.process_time() - began_s) * 3600.0 / flight_s)
    value = f"{median(used):.0f} s ({min(used):.0f} to {max(used):.0f} s, {flights} flights of {flight_s:.0f} s)"
    name = "CPU for a flight hour of four aircraft in an integrity study"
    return Figure(name, value, f"<= {_CPU_GOAL_S:.0f} s", median(used) <= _CPU_GOAL_S)


def _judged(flight_s: float) -> Figure:
    by = JudgedBy.of(load_settings(None, {}))
    with tempfile.TemporaryDirectory() as directory:
        _record(Path(directory) / "flight.tlog", flight_s)
        (found,) = find_recordings([Path(directory)])
        began_s = time.process_time()
        judged = judge_flight(by, found)
        used_s = time.process_time() - began_s
    value = f"{judged.duration_s / used_s:.1f} (a recording of {judged.duration_s:.0f} s, four aircraft, one denied)"
    return Figure("flight hours judged per core hour", value)


def _record(file: Path, flight_s: float) -> None:
    """Write a tlog of four simulated aircraft that range each other, of which one loses its GPS after 20 s."""
    fleet = Fleet(load_scenario(SCENARIOS / "uwb.toml"), seed=3, unix_epoch_s=_UNIX_EPOCH_S)
    with file.open("wb") as log:
        for step in range(1, round(flight_s / STEP_S) + 1):
            for datagram in fleet.advance(step * STEP_S):
                log.write(struct.pack(">Q", round((_UNIX_EPOCH_S + datagram.due_s) * 1e6)) + datagram.payload)


def _scaling(quick: bool) -> list[Figure]:
    """The same tasks one by one, in the plain pool of two, on one Dask worker and on two, in turn.

    What two plain processes gain over one is what the machine's cores leave to gain.
    """
    repeats, tasks = (1, 12) if quick else (3, 20)
    if (os.cpu_count() or 1) < 2:
        return [Figure("scaling on a Dask cluster", "needs two cores")]
    walls: dict[str, list[float]] = {"alone": [], "pool": [], "one": [], "two": []}
    busy: dict[str, list[float]] = {name: [] for name in walls}
    with _dask_workers(1) as one, _dask_workers(2) as two:
        setups: dict[str, tuple[Workers, int]] = {
            "alone": (Workers(1), 1),
            "pool": (Workers(2), 2),
            "one": (Workers(scheduler=one), 1),
            "two": (Workers(scheduler=two), 2),
        }
        for workers, _ in setups.values():  # imports are no part of it
            run_tasks(_fly, list(range(2)), workers, _untold)
        for _ in range(repeats):
            for name, (workers, count) in setups.items():
                began_s = time.perf_counter()
                taken_s = run_tasks(_fly, list(range(tasks)), workers, _untold)
                walls[name].append(time.perf_counter() - began_s)
                busy[name].append(sum(taken_s) / walls[name][-1] / count)
    faster = [a / b for a, b in zip(walls["one"], walls["two"], strict=True)]
    against = [a / b for a, b in zip(walls["pool"], walls["two"], strict=True)]
    possible = [a / b for a, b in zip(walls["alone"], walls["pool"], strict=True)]
    shares = ", ".join(f"{name} {median(found):.1%}" for name, found in busy.items())
    return [
        _ratio("two Dask workers against one, by the clock", faster, _SCALING_GOAL),
        _ratio("two Dask workers against the plain pool of two", against, _POOL_GOAL),
        Figure("the plain pool of two against one process: the machine's own limit", _spread(possible)),
        Figure("share of the time in which workers are at a task", shares),
    ]


def _ratio(name: str, found: list[float], goal: float) -> Figure:
    return Figure(name, _spread(found), f">= {goal} x", median(found) >= goal)


def _spread(found: list[float]) -> str:
    return f"{median(found):.2f} x ({min(found):.2f} to {max(found):.2f}, {len(found)} runs)"


def _fly(seed: int) -> float:
    """Fly a task's flight; returns how long it took by the clock, s."""
    began_s = time.perf_counter()
    fly_trial(_FOUR, seed, duration_s=_TASK_FLIGHT_S)
    return time.perf_counter() - began_s


def _untold(_done: int, _total: int) -> None:
    return


@contextmanager
def _dask_workers(count: int) -> Iterator[str]:
    """Yield the address of a scheduler with so many workers of one thread, each a process."""
    from distributed import LocalCluster

    make: Callable[..., LocalCluster] = LocalCluster
    with make(n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0", host="127.0.0.1") as cluster:
        cluster.wait_for_workers(count)
        yield cluster.scheduler_address
