from math import factorial

from gcs_coloc.study.monte_carlo import run_tasks


def test_results_come_in_the_order_of_the_tasks_and_progress_is_told() -> None:
    told: list[tuple[int, int]] = []

    assert run_tasks(factorial, [3, 1, 2], 1, lambda done, total: told.append((done, total))) == [6, 1, 2]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_two_processes_give_the_same() -> None:
    told: list[int] = []

    assert run_tasks(factorial, list(range(6)), 2, lambda done, _: told.append(done)) == [1, 1, 2, 6, 24, 120]
    assert told == list(range(7))
