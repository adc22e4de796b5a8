"""A demo in containers on a real engine, for tests: its containers, what they say and how they are killed."""

from __future__ import annotations

import fcntl
import json
import os
import secrets
import shutil
import subprocess
import tempfile
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def missing() -> str | None:
    """What the containers need and this machine does not have; None where nothing is missing."""
    if shutil.which("docker") is None or subprocess.run(["docker", "info"], capture_output=True).returncode != 0:
        return "no Docker engine answers here"
    return None if _compose() else "Docker has no Compose here"


def _compose() -> list[str]:
    if subprocess.run(["docker", "compose", "version"], capture_output=True).returncode == 0:
        return ["docker", "compose"]
    return ["docker-compose"] if shutil.which("docker-compose") else []


class Demo:
    """One project of Compose of its own, beside others on the machine, with the page on any free port; of `file`."""

    def __init__(self, file: str = "compose.yaml") -> None:
        self.project = f"gcs-coloc-test-{secrets.token_hex(4)}"
        # The host's network, because a build may reach the packages over that alone; the containers have networks of their own.
        own = {"COMPOSE_PROJECT_NAME": self.project, "COMPOSE_FILE": file, "BUILD_NETWORK": "host"}
        self.environment = os.environ | own | dict.fromkeys(("DEMO_PAGE", "WATCH_PAGE"), "127.0.0.1:")
        self._compose = _compose()
        self._of_project = ["--filter", f"label=com.docker.compose.project={self.project}"]

    def run(self, *command: str, **environment: str) -> str:
        """Run a command to its end in the repository; returns what it printed, and fails with it where it fails."""
        done = subprocess.run(command, cwd=ROOT, env=self.environment | environment, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, f"{' '.join(command)}:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    def compose(self, *arguments: str, **environment: str) -> str:
        """`docker compose ...`."""
        return self.run(*self._compose, *arguments, **environment)

    def build(self, service: str) -> None:
        """Build the image, which all services share; tests that run beside each other wait for the first one's layers."""
        with (Path(tempfile.gettempdir()) / "gcs-coloc-test-image.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self.compose("build", service)

    def container(self, service: str) -> str:
        """The id of a service's container, running or not."""
        own = [*self._of_project, "--filter", f"label=com.docker.compose.service={service}"]
        return self.run("docker", "ps", "-aq", *own).strip()

    def inspect(self, service: str) -> Mapping[str, Any]:
        """What the engine knows of a service's container."""
        found: list[Mapping[str, Any]] = json.loads(self.run("docker", "inspect", self.container(service)))
        return found[0]

    def in_container(self, service: str, *command: str) -> str:
        """Run a command in a service's container as its own user."""
        return self.run("docker", "exec", self.container(service), *command)

    def log(self, container: str, since: str = "0") -> str:
        """What a container has logged from a time on, UNIX seconds or as the engine writes times."""
        command = ["docker", "logs", "--since", since, container]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60).stdout

    def is_healthy(self, service: str) -> bool:
        """Whether a service runs and its health check passes."""
        state = self.inspect(service)["State"]
        return bool(state["Running"] and state["Health"]["Status"] == "healthy")

    def published(self, topic: str) -> Mapping[str, Any]:
        """The next message that the broker gets on a topic of the fleet; what it kept from before does not count."""
        wait = ["-R", "-C", "1", "-W", "60"]
        said: Mapping[str, Any] = json.loads(
            self.in_container("broker", "mosquitto_sub", *wait, "-t", f"gcs-coloc/v2/demo/{topic}")
        )
        return said

    def page(self, service: str = "coloc") -> str:
        """The address of a service's page on the host."""
        return f"http://{self.compose('port', service, '8080').strip()}/"

    @staticmethod
    def fetch(url: str) -> str:
        """What is answered there, asked from the host."""
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(url, timeout=30) as answer:
            text: str = answer.read().decode()
        return text

    def kill(self, service: str) -> None:
        """SIGKILL a service's process from outside, as the kernel does: `docker kill` is the operator's word, and final."""
        process = str(self.inspect(service)["State"]["Pid"])
        self.run("docker", "run", "--rm", "--pid=host", "--user=0", "--entrypoint=sh", "gcs-coloc", "-c", f"kill -9 {process}")

    def left(self) -> list[str]:
        """What the engine still has of this project."""
        containers = self.run("docker", "ps", "-aq", *self._of_project)
        volumes = self.run("docker", "volume", "ls", "-q", *self._of_project)
        networks = self.run("docker", "network", "ls", "-q", *self._of_project)
        return [*containers.split(), *volumes.split(), *networks.split()]
