"""Being here puts the repository on the path, so that tests can import `tests.recordings`."""

from __future__ import annotations

import gc
from itertools import groupby
from operator import attrgetter

import pytest

# As the program itself: a search for cycles after each 700 objects takes some percent of the CPU and finds next to nothing.
gc.set_threshold(20_000, 20, 50)

_WAITING = ("tests/integration/", "tests/browser/")
_LAST_WAITING = 0.85
"""Where among all the last file that waits is begun. Chosen: some of them take two minutes, which are not to be the last ones."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files that wait for a wire or a browser among those that compute: side by side no core idles."""
    files = [list(of_file) for _, of_file in groupby(items, key=attrgetter("path"))]
    waiting = [tests for tests in files if tests[0].nodeid.startswith(_WAITING)]
    computing = [tests for tests in files if not tests[0].nodeid.startswith(_WAITING)]
    placed = [(_LAST_WAITING * k / len(waiting), tests) for k, tests in enumerate(waiting)]
    placed += [((k + 0.5) / len(computing), tests) for k, tests in enumerate(computing)]
    items[:] = [test for _, tests in sorted(placed, key=lambda at: at[0]) for test in tests]


def pytest_collection_finish() -> None:
    """Exclude what was collected from garbage collection: 400,000 objects, in each worker, that stay until the end."""
    gc.freeze()
