"""The page of all fleets over real worker processes: it shows each, leads to its own page, and tells of one that died."""

from __future__ import annotations

import os
import re
import signal
import socket

import pytest
from flight import Watched, browser, flying, service, wait_for, wait_until_good
from playwright.sync_api import expect

from bench.free_ports import free_port

pytestmark = pytest.mark.integration


def test_why_no_vehicle_is_heard_is_told(tmp_path):
    """A notice of the whole fleet; it is not said to be over, for its cause lasts."""
    port, address = free_port(), f"127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    (tmp_path / "key").write_text("5c" * 32)
    (tmp_path / "key").chmod(0o600)
    (tmp_path / "fleets.toml").write_text(
        f'[service]\nprocesses = "per-fleet"\naddress = "{address}"\n[[fleet]]\nname = "north"\n'
        f'links = ["udpin:127.0.0.1:{port}"]\n[fleet.signing]\nkey_file = "{tmp_path / "key"}"\nmode = "require"\n'
    )
    arguments = ["--config", str(tmp_path / "fleets.toml")]
    with service(tmp_path / "log", *arguments), flying(port, set()), browser() as chromium:
        page = Watched(chromium.new_page()).page
        page.goto(f"http://{address}/")
        north = page.get_by_role("region", name=re.compile("^Fleet north on "))
        expect(north).to_contain_text("no vehicle heard yet")
        expect(north.get_by_role("listitem").filter(has_text="unsigned")).to_have_text(
            re.compile("^refused on the links: unsigned")
        )
        over = north.get_by_role("listitem").filter(has_text="over and not acknowledged").all_inner_texts()
        page.goto(re.findall(r"north: web page: (\S+)", (tmp_path / "log").read_text())[0])
        expect(page.locator("#alarms")).to_contain_text("refused on the links")
        # A computer that is busy while both programs start falls behind: that alarm alone may be over, or become so meanwhile.
        fell_behind = page.locator("#alarms li.over[data-kind='host_late']").count()
        assert over in ([], ["1 alarm over and not acknowledged"] * fell_behind)
        expect(page.locator("#alarms li.over:not([data-kind='host_late'])")).to_have_count(0)


def test_it_shows_each_fleet_leads_to_its_own_page_and_tells_of_one_that_died(tmp_path):
    ports = {name: free_port() for name in ("north", "south")}
    address = f"127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    tables = "".join(f'[[fleet]]\nname = "{name}"\nlinks = ["udpin:127.0.0.1:{port}"]\n' for name, port in ports.items())
    (tmp_path / "fleets.toml").write_text(f'[service]\nprocesses = "per-fleet"\naddress = "{address}"\n{tables}')
    log = tmp_path / "log"
    with (
        service(log, "--config", str(tmp_path / "fleets.toml")),
        flying(ports["north"], set()),
        flying(ports["south"], set()),
        browser() as chromium,
    ):
        watched = Watched(chromium.new_page())
        page = watched.page
        page.goto(f"http://{address}/")
        fleets = {name: page.get_by_role("region", name=re.compile(f"^Fleet {name} on ")) for name in ports}
        for name in ports:
            expect(fleets[name]).to_contain_text("4 good")
        expect(page.locator("#problem")).to_be_empty()

        (north,) = map(int, re.findall(r"fleet north: process (\d+)", log.read_text()))
        os.kill(north, signal.SIGSTOP)
        expect(fleets["north"]).to_contain_text("not heard")
        expect(page.locator("#problem")).to_contain_text("fleet north: not heard for")
        os.kill(north, signal.SIGKILL)
        wait_for(lambda: log.read_text().count("fleet north: process ") == 2, "the second process of north")
        expect(fleets["north"]).to_contain_text("4 good")
        expect(page.locator("#problem")).to_be_empty()
        assert watched.complaints == []

        page.get_by_role("link", name="Page of fleet north").click()
        wait_until_good(page, 1, 2, 3, 4)
