"""The service as its user starts it: a process of its own."""

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from bench import free_ports


@pytest.fixture
def free_port() -> int:
    return free_ports.free_port()


@pytest.fixture
def start_service() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `gcs-coloc` with arguments and waits until its link listens; ends it after the test."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "gcs_coloc", *arguments]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        running.append(process)
        assert process.stderr is not None
        for line in process.stderr:
            if "listening on" in line:
                return process
        raise AssertionError(f"the service ended with {process.wait()} before it listened")

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        process.communicate()
