"""A service process, hovering vehicles and a real browser, for the tests of the page."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright
from vehicles import Hover, fly, square_fleet

CHROMIUM = "/usr/bin/chromium"
PATIENCE_S = 60.0
"""Every wait for a state ends here. Chosen: some ten times what a machine with two busy loops beside the test needs."""
TOKEN = "correct-horse-battery"  # of these tests only
expect.set_options(timeout=PATIENCE_S * 1e3)
_FLAGS = ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--disable-background-networking"]


@dataclass
class LiveService:
    """A live service with its page, four vehicles, those of them that have lost their GPS, and a browser."""

    url: str
    failed: set[int]
    chromium: Browser
    udp_port: int
    out_port: int
    folder: Path
    fleet: list[Hover]


@contextlib.contextmanager
def service(log: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """The running process and the address of its page, which it is taken at its word for."""
    with log.open("wb") as out:
        process = subprocess.Popen([sys.executable, "-m", "gcs_coloc", *arguments], stdout=out, stderr=out)
    try:
        while not (found := re.search(r"web page: (http://\S+)", log.read_text())):
            assert process.poll() is None, log.read_text()
            threading.Event().wait(0.05)
        yield process, found.group(1)
    finally:
        process.terminate()
        try:
            process.wait(PATIENCE_S)
        finally:
            process.kill()


@contextlib.contextmanager
def flying(port: int, failed: set[int]) -> Iterator[list[Hover]]:
    """Four vehicles in the air in the background until the end; `failed` may be changed while they fly."""
    landed = threading.Event()
    with square_fleet(port) as fleet:
        thread = threading.Thread(target=fly, args=(fleet, 86_400.0, failed, landed.is_set), daemon=True)
        thread.start()
        try:
            yield fleet
        finally:
            landed.set()
            thread.join()


class Watched:
    """A page with everything it complained of: console errors, exceptions, and requests beyond loopback."""

    def __init__(self, page: Page) -> None:
        page.set_default_timeout(PATIENCE_S * 1e3)
        self.page = page
        self.complaints: list[str] = []
        page.on("console", lambda m: self.complaints.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda r: None if "//127.0.0.1:" in r.url else self.complaints.append(f"request to {r.url}"))


@contextlib.contextmanager
def browser() -> Iterator[Browser]:
    """Debian's chromium, with every name but loopback unresolvable."""
    with sync_playwright() as playwright:
        rules = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=[*_FLAGS, rules])
        try:
            yield chromium
        finally:
            chromium.close()


def card(page: Page, sysid: int) -> Locator:
    return page.locator("#fleet").get_by_role("button", name=f"Vehicle {sysid}")


def wait_until_good(page: Page, *sysids: int) -> None:
    """Each vehicle is heard and its GPS healthy: what a test changes from there on is a change."""
    for sysid in sysids:
        expect(card(page, sysid)).to_have_accessible_name(re.compile(f"^Vehicle {sysid} good, GPS healthy"))


def wait_for(condition, what: str, at_most_s: float = PATIENCE_S) -> None:
    deadline = time.monotonic() + at_most_s
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        threading.Event().wait(0.1)
