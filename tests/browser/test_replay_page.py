"""A recorded flight on the page in a real browser: it plays, pauses, seeks both ways by keyboard, and ends with Ctrl-C."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from command_line import gcs_coloc
from flight import PATIENCE_S, Watched, browser
from playwright.sync_api import WebSocketRoute, expect
from recorded_flight import EPOCH_S, write_flight, write_truth

from gcs_coloc.recorder.tlog import TlogReader, tlog_record

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> tuple[Path, Path]:
    """20 s, vehicle 4 without GPS after 10 s, and the truth of that vehicle."""
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    table = path.with_name("truth.csv")
    write_truth(table, (point for point in write_flight(path, 20.0) if point.sysid == 4))
    return path, table


@pytest.fixture(scope="module")
def long_recording(recording, tmp_path_factory) -> Path:
    """The same flight 180 times on end, an hour: more than is computed during the test."""
    path = tmp_path_factory.mktemp("long") / "long.tlog"
    once = list(TlogReader(recording[0]))
    with path.open("wb") as file:
        for n in range(180):
            file.writelines(tlog_record(record.unix_s + 20.0 * n, record.frame) for record in once)
    return path


@contextlib.contextmanager
def replaying(path: Path, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-m", "gcs_coloc", "replay", str(path), *options, "--web", "127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    found = re.search(r"web page: (http://\S+)", process.stdout.readline())
    assert found is not None
    try:
        yield process, found.group(1)
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def replayed(recording) -> Iterator[tuple[subprocess.Popen[str], str]]:
    path, truth = recording
    with replaying(path, "--truth", str(truth)) as running:
        yield running


def test_a_flight_is_played_paused_and_sought_in_by_keyboard(replayed):
    process, url = replayed
    with browser() as chromium:
        page = chromium.new_page(viewport={"width": 1366, "height": 900})
        watched = Watched(page)
        page.goto(url)
        # From the beginning and slowly: it has played since before the browser was there, and must not be at its end yet.
        assert answer(url, "api/playback", b'{"playing": true, "seek_s": 0, "speed": 0.25}') == 200
        place = page.get_by_role("slider", name="Position in the recording")
        state = page.locator("#connection")
        page.get_by_role("button", name="Pause").click()
        expect(state).to_have_text("replay, paused")
        expect(page.locator("#commands")).to_be_hidden()
        place.focus()
        page.keyboard.press("End")
        expect(place).to_have_attribute("aria-valuetext", re.compile("^0:(19|20) of 0:(19|20)$"))
        alarm = page.locator("#alarms li").filter(has_text="vehicle 4: GPS failed")
        expect(alarm).to_be_visible()
        expect(page.get_by_role("button", name="Vehicle 4: true position")).to_be_visible()
        expect(page.locator("#truth-key")).to_be_visible()
        place.focus()
        page.keyboard.press("Home")
        expect(place).to_have_attribute("aria-valuetext", re.compile("^0:00 of"))
        expect(alarm).to_have_count(0)
        for _ in range(4):
            page.keyboard.press("PageUp")
        expect(page.locator("#fleet").get_by_role("button", name="Vehicle 4")).to_contain_text("GPS healthy")
        page.get_by_label("Speed").select_option("as fast as computed")
        page.get_by_role("button", name="Play").click()
        expect(state).to_have_text("replay, at the end")
        expect(alarm).to_be_visible()
        assert watched.complaints == []
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, told) == (0, "")


def test_a_position_that_is_not_computed_yet_shows_its_progress_and_is_given_up_by_button_and_key(long_recording):
    with replaying(long_recording) as (_, url), browser() as chromium:
        page = chromium.new_page(viewport={"width": 1366, "height": 900})
        watched = Watched(page)
        page.goto(url)
        place, shown = page.get_by_role("slider", name="Position in the recording"), page.locator("#position-text")
        stop, state = page.get_by_role("button", name="Stop here"), page.locator("#connection")
        page.get_by_role("button", name="Pause").click()
        expect(state).to_have_text("replay, paused")
        expect(stop).to_be_disabled()
        place.focus()
        page.keyboard.press("End")
        expect(shown).to_have_text(re.compile(r"^computing \d+:\d\d of (59:59|60:00)$"))
        expect(shown).to_have_text(re.compile(r"^computing 0:[3-5]\d of|^computing [1-9]"))
        expect(state).to_have_text("replay, computing")
        # Another place, behind it, instead.
        page.keyboard.press("Home")
        expect(shown).to_have_text(re.compile(r"^0:00 of (59:59|60:00)$"))
        expect(state).to_have_text("replay, paused")
        page.keyboard.press("End")
        expect(stop).to_be_enabled()
        stop.click()
        expect(state).to_have_text("replay, paused")
        expect(shown).to_have_text(re.compile(r"^\d+:\d\d of (59:59|60:00)$"))
        place.focus()
        page.keyboard.press("End")
        expect(stop).to_be_enabled()
        page.keyboard.press("Escape")
        expect(stop).to_be_disabled()
        expect(state).to_have_text("replay, paused")
        page.keyboard.press("Space")
        expect(state).to_have_text("replay")
        page.keyboard.press("Space")
        expect(state).to_have_text("replay, paused")
        page.keyboard.press("Home")
        for _ in range(30):
            page.keyboard.press("ArrowRight")
        expect(place).to_have_value("30")
        expect(shown).to_have_text(re.compile(r"^0:30 of"))
        assert watched.complaints == []


def answer(url: str, path: str, body: bytes, **headers: str) -> int:
    request = urllib.request.Request(f"{url}{path}", data=body, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as found:
            return found.status
    except urllib.error.HTTPError as error:
        with error:
            return error.code


def test_the_controls_need_no_token_but_no_foreign_page_reaches_them_and_there_are_no_commands(replayed):
    _, url = replayed
    assert answer(url, "api/playback", b'{"playing": false, "speed": "max"}') == 200
    assert answer(url, "api/playback", b'{"seek_s": %f}' % (EPOCH_S + 15.0)) == 200
    assert answer(url, "api/playback", b'{"halt": true}') == 200
    assert answer(url, "api/playback", b'{"speed": -1}') == 422
    assert answer(url, "api/playback", b"x" * 2000) == 413
    assert answer(url, "api/playback", b"{}", Origin="http://evil.example") == 403
    assert answer(url, "api/vehicles/4/gps", b'{"override": "failed"}') == 404


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--web", "--json"], 2, "exclude each other"),
        (["--web", "--speed", "0"], 2, "--speed 0"),
        (["--web", "999.1.1.1:0"], 1, "cannot listen"),
    ],
)
def test_a_mistake_is_one_line(recording, arguments, code, words):
    done = gcs_coloc("replay", recording[0], *arguments)
    assert (done.returncode, len(done.stderr.strip().splitlines())) == (code, 1)
    assert words in done.stderr


def test_an_address_that_is_taken_is_one_line_with_the_remedy(recording):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        address = f"127.0.0.1:{other.getsockname()[1]}"
        command = [sys.executable, "-m", "gcs_coloc", "replay", str(recording[0]), "--web", address]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    told = f"gcs-coloc: error: web page: {address} is in use; choose another with --web HOST:PORT\n"
    assert (done.returncode, done.stderr) == (1, told)


def test_the_fleet_panel_says_why_it_is_empty(replayed):
    _, url = replayed
    with browser() as chromium:
        page = chromium.new_page(viewport={"width": 1366, "height": 900})
        pictures: list[str] = []

        def keep_pictures(ours: WebSocketRoute) -> None:
            server = ours.connect_to_server()
            server.on_message(lambda text: pictures.append(text) if '"kind":"fleet"' in text else ours.send(text))

        page.route_web_socket("**/live", keep_pictures)
        page.goto(url)
        words = page.locator("#no-vehicles")
        expect(words).to_have_text("the first picture is being computed")
        expect(words).to_be_visible()
        page = chromium.new_page(viewport={"width": 1366, "height": 900})
        page.goto(url)
        words = page.locator("#no-vehicles")
        expect(page.locator("#fleet .card")).not_to_have_count(0)
        expect(words).to_be_hidden()
        page.get_by_label("Filter the fleet").fill("no such vehicle")
        expect(words).to_have_text("no vehicle matches the filter")
