"""Ctrl-C while the program ends already says nothing."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

PROGRAM = """
import atexit, signal, {package}.__main__ as program
import {cli} as cli
# A shell starts what runs in the background with Ctrl-C ignored, the tests as well.
signal.signal(signal.SIGINT, signal.default_int_handler)
def run():
    atexit.register(lambda: (print("ending", flush=True), signal.pause()))
    raise SystemExit(130)
cli.main = run
program.main()
"""


@pytest.mark.parametrize(("package", "cli"), [("gcs_coloc", "gcs_coloc.cli.main"), ("sitl_fakes", "sitl_fakes.cli")])
def test_a_second_ctrl_c_ends_the_program_in_silence(package, cli):
    program = PROGRAM.format(package=package, cli=cli)
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as ending:
        try:
            assert ending.stdout.readline() == "ending\n"
            ending.send_signal(signal.SIGINT)
            _, told = ending.communicate(timeout=30.0)
        finally:
            ending.kill()
    assert told == ""
    assert ending.returncode == -signal.SIGINT
