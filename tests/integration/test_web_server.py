"""The page's server in the running service: who may command, what is said when a port is taken, and pages that do not read."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
from command_line import gcs_coloc
from link_peers import PATIENCE_S
from vehicles import fly, square_fleet
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from bench import free_ports

pytestmark = pytest.mark.integration

TOKEN = "a-token-of-this-test"


@pytest.fixture
def web_port() -> int:
    return free_ports.free_port(socket.SOCK_STREAM)


@pytest.fixture
def with_token(tmp_path):
    (tmp_path / "token").write_text(TOKEN)
    (tmp_path / "token").chmod(0o600)
    (tmp_path / "config.toml").write_text(f'[web]\ntoken_file = "{tmp_path / "token"}"\n')
    return str(tmp_path / "config.toml")


@contextlib.contextmanager
def port_kept_from_all(port: int) -> Iterator[None]:
    """A port of loopback is in use while the block runs: by us, or by somebody who held it throughout our patience."""
    with socket.socket() as held:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:  # a service of another test has it for the length of its flight
            with contextlib.suppress(OSError):
                held.bind(("127.0.0.1", port))
                held.listen()
                break
            threading.Event().wait(0.1)
        yield


def wait_until_served(port: int) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            with socket.create_connection(("127.0.0.1", port), timeout=1):
                return
        except OSError:
            pass
    raise AssertionError("the page is not served")


def ask(port: int, path: str, body: bytes | None = None, **headers: str) -> tuple[int, str]:
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", data=body, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_a_command_is_applied_with_the_token_only(start_service, free_port, web_port, with_token):
    start_service("--config", with_token, "--udp", f"127.0.0.1:{free_port}", "--web", f"127.0.0.1:{web_port}")
    wait_until_served(web_port)
    right = {"Authorization": f"Bearer {TOKEN}"}
    command, body = "/api/vehicles/4/gps", b'{"override": "failed"}'
    with square_fleet(free_port) as fleet:
        assert ask(web_port, command, body, **right)[0] == 404
        fly(fleet, 3.0)
        assert ask(web_port, command, body)[0] == 403
        assert ask(web_port, command, body, Authorization="Bearer another-token-of-this-test")[0] == 403
        assert ask(web_port, command, body, **right, Origin="http://evil.example")[0] == 403
        assert ask(web_port, command, body, **right, Host="evil.example")[0] == 403
        assert ask(web_port, command, b'{"override": "landed"}', **right)[0] == 422
        assert ask(web_port, command, b"x" * 5000, **right)[0] == 413
        fly(fleet, 1.0)
        assert not fleet[3].of("GPS_INPUT")
        assert ask(web_port, "/api/vehicles/4/aiding", b'{"override": "off"}', **right) == (200, '{"sysid":4,"override":"off"}')
        assert ask(web_port, "/api/vehicles/4/aiding", body, **right)[0] == 422
        assert ask(web_port, "/api/vehicles/4/other", body, **right)[0] == 404
        assert ask(web_port, command, body, **right) == (200, '{"sysid":4,"override":"failed"}')
        fly(fleet, 1.0)
        assert not fleet[3].of("GPS_INPUT")
        assert ask(web_port, "/api/vehicles/4/aiding", b'{"override": "auto"}', **right)[0] == 200
        fly(fleet, 60.0, until=lambda: bool(fleet[3].of("GPS_INPUT")))
        assert fleet[3].of("GPS_INPUT")
        assert ask(web_port, "/healthz") == (200, "ok\n")
        assert ask(web_port, "/readyz") == (200, "ok\n")
        state = 'gcs_coloc_vehicle_gps_state{state="failed",sysid="4"} 1.0'
        assert state in ask(web_port, "/metrics")[1]


def test_without_a_token_nothing_is_commanded_and_foreign_pages_get_no_socket(start_service, free_port, web_port):
    start_service("--udp", f"127.0.0.1:{free_port}", "--web", f"127.0.0.1:{web_port}")
    wait_until_served(web_port)
    with square_fleet(free_port) as fleet:
        fly(fleet, 1.0)
    assert ask(web_port, "/api/vehicles/4/gps", b'{"override": "failed"}', Authorization="Bearer ")[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{web_port}/live", origin="http://evil.example")
    with connect(f"ws://127.0.0.1:{web_port}/live", origin=f"http://127.0.0.1:{web_port}") as page:
        hello = json.loads(page.recv(60))
        assert (hello["kind"], hello["commands"]) == ("hello", False)
    for path in ("/static/../config.py", "/static/%2e%2e/app.py", "/static/", "/nothing"):
        assert ask(web_port, path)[0] == 404


def test_a_page_that_never_reads_costs_pictures_and_not_the_flight(start_service, free_port, web_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}", "--web", f"127.0.0.1:{web_port}")
    wait_until_served(web_port)
    stuck = []
    for _ in range(8):
        page = socket.socket()
        page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        page.connect(("127.0.0.1", web_port))
        page.sendall(
            f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{web_port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        stuck.append(page)
    pictures: list[float] = []
    reader = threading.Thread(target=read_pictures, args=(f"ws://127.0.0.1:{web_port}/live", pictures))
    with square_fleet(free_port) as fleet:
        reader.start()
        fly(fleet, 2.0)
        # Where the stuck pages held the service up, neither would go on; how fast they do is the machine's affair.
        fly(fleet, PATIENCE_S, failed=[4], until=lambda: len(fleet[3].of("GPS_INPUT")) >= 60 and len(pictures) >= 17)
        assert len(fleet[3].of("GPS_INPUT")) >= 60
        assert len(pictures) >= 17
        assert pictures == sorted(pictures)
        service.send_signal(signal.SIGTERM)
        fly(fleet, PATIENCE_S, failed=[4], until=lambda: service.poll() is not None)
        assert service.wait(PATIENCE_S) == 0
        assert fleet[3].of("GPS_INPUT")[-1].fix_type == 1
    reader.join(PATIENCE_S)
    for page in stuck:
        # Pictures that it has not shown must not pile up: it would show the past as the present when it reads again.
        assert 1 <= everything(page).count(b'"kind":"fleet"') <= 2
        page.close()


def read_pictures(url: str, pictures: list[float]) -> None:
    """Acknowledge and keep the times of all pictures until the service ends."""
    with connect(url) as page, contextlib.suppress(ConnectionClosed):
        while True:
            message = json.loads(page.recv())
            if message["kind"] == "fleet":
                pictures.append(message["at_s"])
                page.send("shown")


def everything(page: socket.socket) -> bytes:
    page.settimeout(60)
    out = b""
    while part := page.recv(65536):
        out += part
    return out


def test_a_port_that_was_asked_for_and_is_taken_ends_the_service_in_one_line(free_port):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        address = f"127.0.0.1:{other.getsockname()[1]}"
        done = gcs_coloc("--udp", f"127.0.0.1:{free_port}", "--web", address, "--log-level", "error")
    assert done.returncode == 1
    assert re.fullmatch(rf"gcs-coloc: error: web page: {address} is in use.*--no-web\n", done.stderr)


def test_a_default_port_that_is_taken_is_done_without(free_port, tmp_path):
    with port_kept_from_all(8080), square_fleet(free_port) as fleet:
        with (tmp_path / "log").open("wb") as log:
            service = subprocess.Popen([sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{free_port}"], stderr=log)
        try:
            fly(fleet, 60.0, until=lambda: "vehicle 4: GPS unknown -> healthy" in (tmp_path / "log").read_text())
            fly(fleet, 60.0, failed=[4], until=lambda: bool(fleet[3].of("GPS_INPUT")))
        finally:
            service.terminate()
            service.wait(60)
        assert fleet[3].of("GPS_INPUT")
    log = (tmp_path / "log").read_text()
    assert "127.0.0.1:8080 is in use" in log
    assert "the flight goes on without the page" in log


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--web", "nonsense"], "HOST:PORT"),
        (["--web", "127.0.0.1:99999"], "HOST:PORT"),
        (["--web", "127.0.0.1:8080", "--no-web"], "exclude"),
    ],
)
def test_a_mistake_in_the_address_is_said_in_one_line(arguments, words):
    done = gcs_coloc("--udp", "14550", *arguments)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert words in done.stderr
