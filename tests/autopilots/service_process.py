"""The service as a process of its own, as its user starts it, and what its metrics say of the vehicles."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Sequence
from pathlib import Path

from bench.free_ports import free_port


class Service:
    """`gcs-coloc` as its user starts it, and the GPS states that its metrics show, as they change."""

    def __init__(self, port: int, directory: Path, configuration: str, states: Sequence[tuple[float, int, str]] = ()) -> None:
        """Start it; `states` are those of the one before, which was killed."""
        self.directory = directory
        self.log = directory / "service.log"
        self._web = free_port(socket.SOCK_STREAM)
        self.states = list(states)
        self._polled_s = 0.0
        self.configuration = file = directory / "gcs-coloc.toml"
        file.write_text(f'links = ["udpin:127.0.0.1:{port}"]\n{configuration}\n', encoding="utf-8")
        command = [sys.executable, "-m", "gcs_coloc", "--config", str(file), "--record", str(directory)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen([*command, "--web", f"127.0.0.1:{self._web}"], stdout=subprocess.DEVNULL, stderr=log)

    def poll(self) -> None:
        """Note GPS states that changed, four times a second at most."""
        now_s = time.time()
        if now_s - self._polled_s < 0.25:
            return
        self._polled_s = now_s
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._web}/metrics", timeout=0.2) as answer:
                text = answer.read().decode()
        except OSError:
            return
        current = {sysid: state for _, sysid, state in self.states}
        for labels in re.findall(r"^gcs_coloc_vehicle_gps_state\{(.*)\} 1(?:\.0)?$", text, re.MULTILINE):
            named = dict(re.findall(r'(\w+)="([^"]*)"', labels))
            sysid, state = int(named["sysid"]), named["state"]
            if current.get(sysid) != state:
                self.states.append((now_s, sysid, state))

    def log_lines(self) -> int:
        """Lines of its log so far, without the one on each vehicle that comes every few seconds."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        return sum(": last heard " not in line for line in lines)

    def kill(self) -> None:
        """End it without a word."""
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        """End it as Ctrl-C does, so that it closes its recording."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=10.0)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    @property
    def recordings(self) -> list[Path]:
        """Its recordings, in order."""
        return sorted(self.directory.glob("*.tlog"))
