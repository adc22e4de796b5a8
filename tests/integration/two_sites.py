"""Two hosts, each with a broker, a service and four vehicles in the air; the second broker is bridged to the first one."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from brokers import PASSWORD, USER, Broker
from vehicles import fly, square_fleet

from bench.free_ports import free_port


class Site:
    """One host: its broker, its service, and the vehicles of it that have lost their GPS."""

    def __init__(self, directory: Path, broker: Broker, fleet: str) -> None:
        self.broker = broker
        self.udp_port = free_port()
        self.failed: set[int] = set()
        self.config = directory / f"{fleet}.toml"
        secret = directory / "password"
        secret.write_text(PASSWORD + "\n")
        secret.chmod(0o600)
        self.config.write_text(
            f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\nusername = "{USER}"\n'
            f'password_file = "{secret}"\nfleet = "{fleet}"\n'
        )
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        command = ["--udp", f"127.0.0.1:{self.udp_port}", "--no-web", "--config", str(self.config), "--log-level", "error"]
        self._process = subprocess.Popen([sys.executable, "-m", "gcs_coloc", *command], stdout=subprocess.DEVNULL)

    def kill(self) -> None:
        """End the service without a word."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def stop(self) -> None:
        """End the service in order."""
        assert self._process is not None
        self._process.terminate()
        assert self._process.wait(30.0) == 0

    @contextlib.contextmanager
    def flying(self) -> Iterator[None]:
        landed = threading.Event()
        with square_fleet(self.udp_port) as fleet:
            thread = threading.Thread(target=fly, args=(fleet, 86_400.0, self.failed, landed.is_set), daemon=True)
            thread.start()
            try:
                yield
            finally:
                landed.set()
                thread.join()


@contextlib.contextmanager
def two_sites(directory: Path, fleets: tuple[str, str] = ("north", "north")) -> Iterator[tuple[Site, Site]]:
    """Both sites in flight; the first one's broker gets everything."""
    upper, lower = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_STREAM)
    folders = directory / "a", directory / "b"
    for folder in folders:
        folder.mkdir()
    brokers = Broker(folders[0], upper), Broker(folders[1], lower, bridged_to=upper)
    sites = tuple(Site(*each) for each in zip(folders, brokers, fleets, strict=True))
    with contextlib.ExitStack() as stack:
        for site in sites:
            site.broker.start()
            stack.callback(site.broker.kill)
            stack.enter_context(site.flying())
            site.start()
            stack.callback(site.kill)
        yield sites[0], sites[1]
