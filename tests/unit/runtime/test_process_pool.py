from math import factorial

from gcs_coloc.runtime.process_pool import iterate_tasks, run_tasks


def test_results_come_in_the_order_of_the_tasks_and_progress_is_told() -> None:
    told: list[tuple[int, int]] = []

    assert run_tasks(factorial, [3, 1, 2], 1, lambda done, total: told.append((done, total))) == [6, 1, 2]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_two_processes_give_the_same() -> None:
    told: list[int] = []

    assert run_tasks(factorial, list(range(6)), 2, lambda done, _: told.append(done)) == [1, 1, 2, 6, 24, 120]
    assert told == list(range(7))


def test_results_come_as_they_are_ready_and_no_task_is_begun_in_vain():
    begun = []

    def tasks():
        for n in range(100):
            begun.append(n)
            yield n

    results = iterate_tasks(factorial, tasks(), jobs=1)
    assert [next(results), next(results), next(results)] == [1, 1, 2]
    assert len(begun) == 3
    assert sorted(iterate_tasks(factorial, range(5), jobs=2)) == [1, 1, 2, 6, 24]
