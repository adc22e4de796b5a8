"""A computer that falls behind, in a real browser: it has a service and a browser of its own, as it is stopped for a while."""

from __future__ import annotations

import re
import signal
import threading

import pytest
from flight import Watched, browser, flying, service, wait_until_good
from playwright.sync_api import expect

from bench.free_ports import free_port

pytestmark = pytest.mark.integration


def test_a_computer_that_falls_behind_is_a_line_of_its_own_and_no_vehicle_is_called_silent_for_it(tmp_path):
    port = free_port()
    arguments = ["--udp", f"127.0.0.1:{port}", "--web", "127.0.0.1:0"]
    with service(tmp_path / "log", *arguments) as (process, url), flying(port, set()), browser() as chromium:
        page = Watched(chromium.new_page()).page
        page.goto(url)
        wait_until_good(page, 1, 2, 3, 4)
        process.send_signal(signal.SIGSTOP)
        threading.Event().wait(5.0)  # longer than a vehicle may be silent
        process.send_signal(signal.SIGCONT)
        line = page.locator("#alarms li[data-kind='host_late']")
        expect(line).to_contain_text(re.compile(r"this computer falls behind: it ran the service \d+\.\d s late"))
        expect(line).not_to_contain_text("vehicle 1")
        expect(line).to_have_class("warning over")
        wait_until_good(page, 1, 2, 3, 4)
        expect(page.locator("#alarms li[data-kind='silent']")).to_have_count(0)
        expect(page.locator("#log li").filter(has_text="not heard for")).to_have_count(0)
