"""A live service with four vehicles in the air, shared by the tests of one file, and a page on it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from flight import TOKEN, LiveService, Watched, browser, flying, service, wait_until_good

from bench.free_ports import free_port


@pytest.fixture(scope="module")
def live(tmp_path_factory) -> Iterator[LiveService]:
    folder = tmp_path_factory.mktemp("web")
    (folder / "token").write_text(f"{TOKEN}\n")
    (folder / "token").chmod(0o600)
    # A receiver that is back is believed soon: what the page shows is tested, and not how long that takes.
    health = "[gps_health]\nsteady_after_s = 0.5\nrecover_after_s = 2.0\n"
    (folder / "config.toml").write_text(f'{health}[web]\ntoken_file = "{folder / "token"}"\n')
    port, out_port, failed = free_port(), free_port(), set()
    ground = ["--out", f"udpin:127.0.0.1:{out_port}"]
    arguments = [*ground, "--config", str(folder / "config.toml"), "--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0"]
    with service(folder / "log", *arguments) as (_, url), flying(port, failed) as fleet, browser() as chromium:
        yield LiveService(url, failed, chromium, port, out_port, folder, fleet)


@pytest.fixture
def watched(live) -> Iterator[Watched]:
    """A page on which all four vehicles are good."""
    live.failed.clear()
    watched = Watched(live.chromium.new_page(viewport={"width": 1366, "height": 900}))
    watched.page.goto(live.url)
    wait_until_good(watched.page, 1, 2, 3, 4)
    yield watched
    watched.page.close()
