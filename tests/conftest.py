"""The order of the tests. Being here puts the repository on the path, so that tests can import `tests.recordings`."""

from __future__ import annotations

from itertools import islice
from math import ceil
from pathlib import Path

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files on a wire and in the browser wait for most of their minutes: between them stand those that compute.

    Of each kind the largest come first, as they take longest: no core idles at the end. One process keeps the order of names.
    """
    if not hasattr(config, "workerinput"):
        return
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    on_wire, computing = [], []
    for path in sorted(files, key=lambda path: path.stat().st_size, reverse=True):
        is_on_wire = any(test.get_closest_marker("integration") for test in files[path])
        (on_wire if is_on_wire else computing).append(files[path])
    rest, share = iter(computing), ceil(len(computing) / max(len(on_wire), 1))
    mixed = [file for wire in on_wire for file in (wire, *islice(rest, share))]
    items[:] = [test for tests in (*mixed, *rest) for test in tests]
