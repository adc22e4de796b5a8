"""The demo: what it can show and what not is told before the flight."""

from __future__ import annotations

import sys

import pytest

from gcs_coloc.core.errors import UsageError
from gcs_coloc.study import demo
from gcs_coloc.study.demo import run_demo


@pytest.fixture(autouse=True)
def _nothing_flies(monkeypatch):
    def fly(*_arguments):
        raise AssertionError("it flies")

    monkeypatch.setattr(demo, "_fly_live", fly)


def test_that_there_is_no_matplotlib_is_told_before_the_flight(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(UsageError, match=r"needs matplotlib: pip install \"gcs-coloc\[plots\]\""):
        run_demo(tmp_path, "paper", "fleet", 1)
