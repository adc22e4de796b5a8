import gc
import os
import pickle
import signal
import subprocess
import sys
from functools import partial
from math import factorial
from pathlib import Path

import pytest

from gcs_coloc.core.errors import TaskError, UsageError
from gcs_coloc.runtime.tasks import KeptResults, Workers, iterate_tasks, run_tasks


def die_once(directory: Path, number: int) -> int:
    """The first call ever for 3 kills its process, as the kernel does when memory runs out."""
    mark = directory / "died"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def die(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_results_come_in_the_order_of_the_tasks_and_progress_is_told() -> None:
    told: list[tuple[int, int]] = []

    assert run_tasks(factorial, [3, 1, 2], Workers(), lambda done, total: told.append((done, total))) == [6, 1, 2]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_two_processes_give_the_same() -> None:
    told: list[int] = []

    assert run_tasks(factorial, list(range(6)), Workers(2), lambda done, _: told.append(done)) == [1, 1, 2, 6, 24, 120]
    assert told == list(range(7))


def young_objects(_number: int) -> int:
    return gc.get_threshold()[0]


def test_processes_search_for_cycles_seldom_and_the_caller_keeps_its_own_way() -> None:
    before = gc.get_threshold()
    assert min(run_tasks(young_objects, [1, 2], Workers(jobs=2), lambda _done, _total: None)) > 10_000
    assert gc.get_threshold() == before


def test_no_tasks_have_no_results() -> None:
    assert run_tasks(factorial, [], Workers(2), lambda *_: None) == []


def test_results_come_as_they_are_ready_and_no_task_is_begun_in_vain():
    begun = []

    def tasks():
        for n in range(100):
            begun.append(n)
            yield n

    results = iterate_tasks(factorial, tasks(), Workers())
    assert [next(results), next(results), next(results)] == [1, 1, 2]
    assert len(begun) == 3
    assert sorted(iterate_tasks(factorial, range(5), Workers(2))) == [1, 1, 2, 6, 24]


def test_whoever_stops_reading_starts_no_more_than_run() -> None:
    begun = []

    def tasks():
        for n in range(100):
            begun.append(n)
            yield n

    results = iterate_tasks(factorial, tasks(), Workers(2))
    next(results)
    results.close()

    assert len(begun) <= 3


def test_a_process_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    told: list[int] = []

    squares = run_tasks(partial(die_once, tmp_path), list(range(8)), Workers(2), lambda done, _: told.append(done))

    assert (tmp_path / "died").exists()
    assert squares == [n * n for n in range(8)]
    assert told == list(range(9))


def test_tasks_that_kill_every_process_end_with_an_error() -> None:
    with pytest.raises(TaskError, match=r"3 processes in a row were killed.*--jobs"):
        run_tasks(die, [1, 2], Workers(2), lambda *_: None)


def test_its_processes_end_with_a_program_that_is_killed() -> None:
    program = """
from gcs_coloc.runtime.tasks import Workers, run_tasks

if __name__ == "__main__":
    # Each line at once, so that those of two processes do not mix.
    task = "__import__('os').write(1, b'begun\\\\n') and __import__('time').sleep(600.0)"
    run_tasks(eval, [task] * 2, Workers(2), lambda *_: None)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert [process.stdout.readline(), process.stdout.readline()] == ["begun\n"] * 2
        finally:
            process.kill()
        # The output ends when the last of them has.
        assert process.communicate(timeout=60.0) == ("", None)


def log(file: Path, number: int) -> int:
    with file.open("a") as opened:
        opened.write(f"{number}\n")
    return number * number


def test_a_run_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    kept, done, told = KeptResults(tmp_path / "kept"), tmp_path / "done", []
    function = partial(log, done)
    run_tasks(function, [1, 2], Workers(), lambda *_: None, kept)

    again = run_tasks(function, [1, 2, 3], Workers(), lambda n, total: told.append((n, total)), kept)

    assert again == [1, 4, 9]
    assert done.read_text().split() == ["1", "2", "3"]
    assert told == [(2, 3), (3, 3)]


def test_results_of_another_program_are_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, done = KeptResults(tmp_path / "kept"), tmp_path / "done"
    run_tasks(partial(log, done), [1], Workers(), lambda *_: None, kept)
    monkeypatch.setattr("gcs_coloc.runtime.tasks.program_versions", lambda: {"source": "another"})
    run_tasks(partial(log, done), [1], Workers(), lambda *_: None, kept)

    assert done.read_text().split() == ["1", "1"]


@pytest.mark.parametrize(
    "content",
    [b"", b"\x80\xff", pickle.dumps([1, 2])[:-3], b"a", b"Inine\n.", b"cgcs_coloc\nnone\n.", b"cnowhere\nnone\n.", b"\x85."],
)
def test_a_kept_result_that_is_damaged_is_named(tmp_path: Path, content: bytes) -> None:
    kept = KeptResults(tmp_path / "kept")
    path = kept.path_of(factorial, 3)
    path.write_bytes(content)

    with pytest.raises(UsageError, match=f"{path.name} cannot be read"):
        run_tasks(factorial, [3], Workers(), lambda *_: None, kept)
