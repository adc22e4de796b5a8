"""What the command line costs before it has anything to do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import pytest

_PRODUCT = "import numpy as np, pathlib; a = np.ones((600, 600)); a @ a; print(pathlib.Path('/proc/self/status').read_text())"


def run(code: str, **environment: str) -> str:
    kept = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60, env=kept | environment
    ).stdout


def test_the_command_line_imports_nothing_of_the_flight_before_it_is_told_to_fly():
    loaded = json.loads(run("import sys, json, gcs_coloc.cli.main; print(json.dumps([m.split('.')[0] for m in sys.modules]))"))
    assert not {"numpy", "scipy", "pydantic", "pymavlink", "starlette", "matplotlib"} & set(loaded)


NOT_FOR_THE_FIRST_MESSAGE = (
    "gcs_coloc.evaluation",
    "gcs_coloc.web",
    "gcs_coloc.recorder.formats.mcap_file",
    "gcs_coloc.recorder.recorder",
    "aiomqtt",
    "matplotlib",
    "mcap",
    "rich",
    "scipy.special",
    "starlette",
    "uvicorn",
)


def test_a_service_imports_what_only_observers_need_after_it_hears_vehicles():
    code = (
        "import sys, json, asyncio\n"
        "from gcs_coloc.config.fleets import load_fleets\n"
        "from gcs_coloc.service.service import Service\n"
        "Service(load_fleets(None, {'links': ['udpin:127.0.0.1:1'], 'mqtt': {'host': 'localhost'}}))\n"
        "print(json.dumps(list(sys.modules)))"
    )
    loaded = json.loads(run(code))
    assert "gcs_coloc.estimators" in loaded
    assert not set(NOT_FOR_THE_FIRST_MESSAGE) & set(loaded)


def test_the_linear_algebra_gets_one_thread():
    told = run(f"from gcs_coloc.runtime.process import one_thread; one_thread(); {_PRODUCT}")
    assert "\nThreads:\t1\n" in told


def test_who_asks_for_more_threads_gets_them():
    told = run(
        "from gcs_coloc.runtime.process import one_thread; one_thread(); import os; print(os.environ['OPENBLAS_NUM_THREADS'])",
        OPENBLAS_NUM_THREADS="2",
    )
    assert told.strip() == "2"


def test_the_entry_point_sets_it_before_anything_else_is_imported():
    told = run(
        "import sys; sys.argv[1:] = ['--version']; from gcs_coloc.__main__ import main; import gc, os\n"
        "try: main()\n"
        "except SystemExit: print('numpy' in sys.modules, os.environ['OPENBLAS_NUM_THREADS'], gc.get_threshold()[0] > 10_000)"
    )
    assert told.splitlines()[-1] == "False 1 True"


def test_a_service_imports_what_it_needs_without_searching_it_for_garbage():
    told = run(
        "import sys; sys.argv[1:] = ['--config', 'no-file.toml']; from gcs_coloc.__main__ import main; import gc\n"
        "searches = lambda: sum(each['collections'] for each in gc.get_stats())\n"
        "before = searches()\n"
        "try: main()\n"
        "except SystemExit: print(searches() - before, gc.isenabled(), gc.get_freeze_count())"
    )
    searches, enabled, excluded = told.split()
    assert int(searches) < 6  # by Python's thresholds, before ours are set; there were 37
    assert enabled == "True"
    assert int(excluded) > 50_000


_INTERRUPTED = """
import os, signal, sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupts())
sys.argv = ["program", *{arguments!r}]
from {package}.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("package", "imported", "status"),
    [
        ("gcs_coloc", "typer", -signal.SIGINT),
        ("gcs_coloc", "gcs_coloc.cli.main", -signal.SIGINT),
        ("gcs_coloc", "numpy", 130),
        ("sitl_fakes", "typer", -signal.SIGINT),
        ("sitl_fakes", "numpy", -signal.SIGINT),
    ],
)
def test_ctrl_c_while_packages_are_imported_ends_it_without_a_traceback(package, imported, status):
    arguments = ["--udp", "127.0.0.1:1", "--no-web"] if package == "gcs_coloc" else ["no-scenario.toml"]
    code = _INTERRUPTED.format(name=imported, package=package, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "")
