"""Tasks on a Dask cluster, with a real scheduler and real workers on loopback: the same results as without it."""

import json
import math
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Thread

import pytest
from brokers import wait_until
from command_line import gcs_coloc
from dask_processes import ROOT, Cluster, dask_cluster, fail, square, wait_to_be_killed, where
from recorded_flight import early_loss, write_flight

from gcs_coloc.core.errors import ClusterError, UsageError
from gcs_coloc.runtime.dask_cluster import check_address
from gcs_coloc.runtime.tasks import Workers, iterate_tasks, run_tasks
from gcs_coloc.study.integrity import trial_runs
from gcs_coloc.study.integrity.trial import TrialScore
from gcs_coloc.study.paper import run_paper_study
from gcs_coloc.study.paper_filters import KINDS
from gcs_coloc.study.paper_options import PaperOptions

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def cluster(tmp_path_factory) -> Iterator[Cluster]:
    with dask_cluster(tmp_path_factory.mktemp("dask"), 2) as started:
        yield started


@pytest.fixture(scope="module")
def harmed(tmp_path_factory) -> Iterator[Cluster]:
    """For tests that do harm to its workers."""
    with dask_cluster(tmp_path_factory.mktemp("harmed"), 0) as started:
        yield started


@pytest.fixture
def own_cluster(harmed) -> Iterator[Cluster]:
    """Without a worker, before a test and after it."""
    yield harmed
    harmed.end_workers()


def quiet(done: int, total: int) -> None:
    assert 0 <= done <= total


def test_results_are_in_order_both_workers_work_and_progress_is_told(cluster: Cluster) -> None:
    told: list[tuple[int, int]] = []
    workers, numbers = Workers(scheduler=cluster.address), list(range(20))

    assert run_tasks(square, numbers, workers, lambda done, total: told.append((done, total))) == [n * n for n in numbers]
    assert told == [(done, 20) for done in range(21)]
    pids = {worker.process.pid for worker in cluster.workers}
    assert set(run_tasks(where, list(range(40)), workers, quiet)) <= pids


def test_no_task_is_begun_in_vain(cluster: Cluster) -> None:
    begun = []

    def tasks():
        for n in range(1000):
            begun.append(n)
            yield n

    results = iterate_tasks(square, tasks(), Workers(scheduler=cluster.address))
    next(results)
    results.close()

    assert len(begun) <= 5


def test_a_worker_that_is_killed_in_the_middle_loses_nothing(own_cluster: Cluster, tmp_path: Path) -> None:
    for _ in range(2):
        own_cluster.add_worker()
    mark = tmp_path / "pid"

    def kill() -> None:
        wait_until(mark.exists)
        os.kill(int(mark.read_text()), signal.SIGKILL)

    killer = Thread(target=kill)
    killer.start()
    told: list[int] = []
    done = run_tasks(
        partial(wait_to_be_killed, tmp_path), list(range(12)), Workers(scheduler=own_cluster.address), lambda n, _: told.append(n)
    )
    killer.join()

    assert done == [n * n for n in range(12)]
    assert told == list(range(13))
    killed = [worker for worker in own_cluster.workers if worker.process.pid == int(mark.read_text())]
    assert [worker.process.wait() for worker in killed] == [-signal.SIGKILL]


def test_a_task_that_kills_its_workers_is_given_up(own_cluster: Cluster) -> None:
    for _ in range(4):
        own_cluster.add_worker()

    with pytest.raises(ClusterError, match="4 workers in a row that died"):
        run_tasks(fail, [1], Workers(scheduler=own_cluster.address), quiet)


def test_a_scheduler_that_is_gone_ends_the_command_in_one_line(tmp_path: Path) -> None:
    with dask_cluster(tmp_path, 1) as gone:

        def kill() -> None:
            wait_until((tmp_path / "pid").exists)
            gone.scheduler.kill()

        killer = Thread(target=kill)
        killer.start()
        with pytest.raises(ClusterError, match="is gone; start it and run the command again"):
            run_tasks(partial(wait_to_be_killed, tmp_path), [0, 1], Workers(scheduler=gone.address), quiet)
        killer.join()


def test_the_papers_study_is_that_of_this_process(cluster: Cluster) -> None:
    options = PaperOptions(seeds=6, qs=(1.0, 20.0), figure_q=20.0, duration_s=8.0, first_part_s=4.0, fleet_seeds=1)
    studies = [run_paper_study(options, workers, quiet) for workers in (Workers(scheduler=cluster.address), Workers(1))]

    assert studies[0].rows == studies[1].rows
    assert len(studies[0].rows) == 2 * len(KINDS) + 1


def test_recordings_are_judged_alike_though_a_worker_is_killed(own_cluster: Cluster, tmp_path: Path) -> None:
    for name in "abcd":
        (tmp_path / "year" / name).mkdir(parents=True)
    flight = tmp_path / "year/a/flight.tlog"
    write_flight(flight, 10.0, early_loss(lost_s=5.0))  # vehicle 4 is located from 7 s on
    for name in "bcd":
        shutil.copy(flight, tmp_path / "year" / name)
    workers = [own_cluster.add_worker() for _ in range(2)]

    def kill() -> None:
        wait_until(lambda: any((tmp_path / "cluster").glob("*.pickle")))
        workers[0].kill()

    killer = Thread(target=kill)
    killer.start()
    ran = gcs_coloc("judge", tmp_path / "year", "--scheduler", own_cluster.address, "--out", tmp_path / "cluster")
    killer.join()
    assert ran.returncode == 0, ran.stderr
    ran = gcs_coloc("judge", tmp_path / "year/a", "--jobs", "1", "--out", tmp_path / "here")
    assert ran.returncode == 0, ran.stderr

    assert workers[0].process.returncode == -signal.SIGKILL
    four, (here,) = (json.loads((tmp_path / where / "judge.json").read_text())["recordings"] for where in ("cluster", "here"))
    assert [one.pop("name") for one in four] == [f"year/{name}/flight.tlog" for name in "abcd"]
    assert here.pop("name") == "a/flight.tlog"
    assert four == [here] * 4


def data_set(directory: Path) -> Path:
    """A tag that stands among three anchors, ranged exactly for four seconds."""
    directory.mkdir()
    nodes = {"tag": (3.0, 4.0), "A": (0.0, 0.0), "B": (20.0, 0.0), "C": (0.0, 20.0)}
    meta = [f'name = "{directory.name}"', 'source = "made by hand"', 'licence = "MIT"', "dims = 2"]
    for name, (e, n) in nodes.items():
        its = 'role = "denied"' if name == "tag" else f'role = "anchor"\ne_m = {e}\nn_m = {n}\nu_m = 1.0\nsigma_m = 0.02'
        meta += ["[[node]]", f'id = "{name}"', its]
    tag = nodes.pop("tag")
    ranges = [f"{k / 5},tag,{name},{math.dist(tag, place):.5f},0.1" for k in range(20) for name, place in nodes.items()]
    (directory / "meta.toml").write_text("\n".join(meta) + "\n")
    (directory / "ranges.csv").write_text("\n".join(["t_s,from_id,to_id,range_m,sigma_m", *ranges]) + "\n")
    (directory / "positions.csv").write_text("t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m\n0.0,tag,3.5,3.5,1,1,1\n")
    (directory / "truth.csv").write_text("\n".join(["t_s,id,e_m,n_m,u_m", *(f"{k / 5},tag,3,4,1" for k in range(20))]) + "\n")
    return directory


def test_data_sets_are_evaluated_alike(cluster: Cluster, tmp_path: Path) -> None:
    walks = [data_set(tmp_path / name) for name in ("one", "two", "three")]
    tables = []
    for workers in (("--scheduler", cluster.address), ("--jobs", "1")):
        ran = gcs_coloc("evaluate", *walks, *workers, "--csv", tmp_path / "epochs.csv")
        assert ran.returncode == 0, ran.stderr
        tables.append((ran.stdout, (tmp_path / "epochs.csv").read_text()))

    assert tables[0] == tables[1]
    assert tables[0][1].count("tag") == 60


def test_a_plan_is_predicted_alike(cluster: Cluster, tmp_path: Path) -> None:
    plans = [ROOT / f"examples/plans/{name}.plan" for name in ("survey-north", "survey-south", "relay")]
    told = []
    for workers in (("--scheduler", cluster.address), ("--jobs", "1")):
        ran = gcs_coloc("plan", *plans, *workers, "--no-improve", "--json", "--csv", tmp_path / "steps.csv")
        assert ran.returncode == 0, ran.stderr
        told.append((json.loads(ran.stdout), (tmp_path / "steps.csv").read_text()))

    assert told[0] == told[1]
    assert [vehicle["sysid"] for vehicle in told[0][0]["vehicles"]] == [1, 2, 3]


def test_integrity_trials_go_on_on_a_cluster(cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flags = ["study", "integrity", "--class", "one-peer", "--out", tmp_path]
    with monkeypatch.context() as patched:
        patched.setattr(trial_runs, "fly_trial", lambda name, seed, estimator: TrialScore(name, seed))
        assert gcs_coloc(*flags, "--seeds", "1", "--jobs", "1").returncode == 0
    flown = (tmp_path / "flights.jsonl").read_text()

    assert gcs_coloc(*flags, "--seeds", "2", "--scheduler", cluster.address).returncode == 0

    both = (tmp_path / "flights.jsonl").read_text()
    assert both.startswith(flown)
    (second,) = map(json.loads, both[len(flown) :].splitlines())
    assert (second["name"], second["seed"]) == ("one-peer", 2)
    assert second["under_aid_s"] > 0.0


def test_without_the_extra_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "distributed"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "distributed", None)

    ran = gcs_coloc("study", "planning", "--scheduler", "tcp://127.0.0.1:8786")

    assert ran.returncode == 1
    assert ran.stderr == (
        "gcs-coloc: error: --scheduler needs the extra cluster: pip install 'gcs-coloc[cluster]' (distributed is missing)\n"
    )


def test_a_scheduler_that_does_not_answer_is_named(free_port: int) -> None:
    address = f"tcp://127.0.0.1:{free_port}"
    ran = gcs_coloc("study", "planning", "--scheduler", address)

    assert ran.returncode == 1
    assert len(ran.stderr.splitlines()) == 1
    # A machine that is so busy that the time is over before the refusal is heard says the second.
    reasons = ("refused", "no answer in time")
    assert any(f"no Dask scheduler answers at {address}: " in ran.stderr and reason in ran.stderr for reason in reasons)
    assert "start one with `dask scheduler`" in ran.stderr


def test_a_scheduler_without_workers_is_told(own_cluster: Cluster) -> None:
    ran = gcs_coloc("study", "planning", "--scheduler", own_cluster.address)

    assert (ran.returncode, len(ran.stderr.splitlines())) == (1, 1)
    assert f"has no worker; start one with `dask worker {own_cluster.address}" in ran.stderr


@pytest.mark.parametrize(
    "address", ["127.0.0.1:8786", "tcp://:8786", "tcp://host", "udp://host:1", "tcp://host:0", "tcp://h:99999"]
)
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(UsageError, match="expected tcp://HOST:PORT"):
        check_address(address)


@pytest.mark.parametrize("address", ["tcp://host:8786", "tls://10.0.0.1:1", "tcp://[::1]:8786"])
def test_an_address_is_taken(address: str) -> None:
    check_address(address)


def test_jobs_and_a_scheduler_exclude_each_other() -> None:
    ran = gcs_coloc("study", "planning", "--scheduler", "tcp://127.0.0.1:8786", "--jobs", "2")

    assert (ran.returncode, len(ran.stderr.splitlines())) == (2, 1)
    assert "--jobs and --scheduler exclude each other" in ran.stderr


def program_in(directory: Path, last_line: str) -> dict[str, str]:
    """The environment of a worker whose copy of the program ends with another line."""
    shutil.copytree(ROOT / "gcs_coloc", directory / "gcs_coloc")
    start = directory / "gcs_coloc" / "__init__.py"
    start.write_text(f"{start.read_text()}\n{last_line}\n")
    return {"PYTHONPATH": str(directory)}


@pytest.mark.parametrize(
    ("last_line", "told"),
    [
        ("# another state", "has another source of this version: its results could differ; install the same there as here"),
        (
            "raise ModuleNotFoundError('No module')",
            "cannot import gcs-coloc: ModuleNotFoundError('No module'); install this version there",
        ),
    ],
)
def test_a_worker_with_another_program_is_refused(own_cluster: Cluster, tmp_path: Path, last_line: str, told: str) -> None:
    own_cluster.add_worker(program_in(tmp_path / "other", last_line))

    ran = gcs_coloc("study", "planning", "--scheduler", own_cluster.address)

    assert (ran.returncode, len(ran.stderr.splitlines())) == (1, 1)
    assert told in ran.stderr


def test_a_worker_with_another_program_that_joins_later_is_refused(own_cluster: Cluster, tmp_path: Path) -> None:
    own_cluster.add_worker()
    tasks = iter(range(1000))

    def join_at_10() -> Iterator[int]:
        for number in tasks:
            if number == 10:
                own_cluster.add_worker(program_in(tmp_path / "other", "# another state"))
            yield number

    with pytest.raises(ClusterError, match="has another source of this version"):
        list(iterate_tasks(square, join_at_10(), Workers(scheduler=own_cluster.address)))
