"""The real mosquitto for tests: on a port of loopback, with a user and a password."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path

USER, PASSWORD = "gcs", "correct horse"


def _program(name: str) -> str:
    found = shutil.which(name, path=os.environ.get("PATH", "") + os.pathsep + "/usr/sbin")
    assert found is not None, f"{name} is not installed: sh tools/install-test-tools"
    return found


def certificate_for(name: str, directory: Path) -> tuple[Path, Path]:
    """A new self-signed certificate for an IP address, and its key."""
    certificate, key = directory / "cert.pem", directory / "key.pem"
    made = ["-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=test", "-addext", f"subjectAltName=IP:{name}"]
    command = [_program("openssl"), "req", *made, "-keyout", key, "-out", certificate]
    subprocess.run(command, check=True, capture_output=True)
    return certificate, key


class Broker:
    """One broker that can be killed and started again on its port. It keeps nothing over a restart.

    With `certificate`, the files of a certificate and its key, it speaks TLS only. `bridged_to` is the port of another broker to
    which it hands on what is published below `gcs-coloc/`, there below `site-b/`.
    """

    def __init__(
        self, directory: Path, port: int, certificate: tuple[Path, Path] | None = None, bridged_to: int | None = None
    ) -> None:
        self.port = port
        users, self._config = directory / "users", directory / "mosquitto.conf"
        subprocess.run([_program("mosquitto_passwd"), "-b", "-c", users, USER, PASSWORD], check=True, capture_output=True)
        users.chmod(0o644)  # started as root, the broker reads it as its own user
        directory.chmod(0o755)
        lines = [f"listener {port} 127.0.0.1", f"password_file {users}", "allow_anonymous false", "user root"]
        if certificate is not None:
            lines += [f"certfile {certificate[0]}", f"keyfile {certificate[1]}"]
        if bridged_to is not None:
            lines += [
                "connection upwards",
                f"address 127.0.0.1:{bridged_to}",
                "restart_timeout 1",
                "bridge_attempt_unsubscribe false",
            ]
            lines += [f"remote_username {USER}", f"remote_password {PASSWORD}", "topic # out 0 gcs-coloc/ site-b/"]
        self._config.write_text("\n".join(lines) + "\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start, and return when it listens."""
        self._process = process = subprocess.Popen([_program("mosquitto"), "-c", self._config], stderr=subprocess.PIPE)
        assert process.stderr is not None
        for line in process.stderr:
            if b" running" in line:
                return
        raise AssertionError(f"mosquitto ended with {process.wait()}")

    def kill(self) -> None:
        """End it without a word."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def signal(self, number: int) -> None:
        """Send it a signal."""
        assert self._process is not None
        self._process.send_signal(number)


def wait_until(condition, patience_s: float = 40.0) -> None:
    """Wait for another process's doing; a test that waits `patience_s` has failed."""
    end = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)
