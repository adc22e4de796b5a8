"""The report of a flight: one page that says what happened and loads nothing."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser

import pytest
from command_line import gcs_coloc
from matplotlib.image import imread
from recorded_flight import LOST_S, write_flight

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.flight_history import read_history
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    directory = tmp_path_factory.mktemp("report")
    write_flight(directory / "flight <4>.tlog", 16.0)
    path = directory / "flight <4>.tlog"
    path.write_bytes(path.read_bytes()[:-5])
    done = gcs_coloc("report", path)
    assert done.returncode == 0, done.stderr
    return done, path.with_suffix(".html").read_text(encoding="utf-8")


class Page(HTMLParser):
    """The page's elements with their attributes, its table rows, and the elements left open."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements, self.rows, self.stack = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag == "tr":
            self.rows.append([])
        if tag not in ("meta", "img", "source"):
            self.stack.append(tag)

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        if self.stack and self.stack[-1] in ("td", "th"):
            self.rows[-1].append(data)


def test_the_page_is_whole_and_loads_nothing(written):
    _, text = written
    page = Page(text)
    assert page.stack == []
    sources = [a[name] for _, a in page.elements for name in ("src", "srcset", "href") if name in a]
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"url\(|@import|<script|https?://", text)
    [policy] = [a["content"] for tag, a in page.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    for source in sources:
        assert base64.b64decode(source.partition(",")[2]).startswith(b"\x89PNG")
    assert all(a.get("alt") for tag, a in page.elements if tag == "img")


def corner(data_url: str) -> float:
    """How bright the corner of a picture is, 0 to 1."""
    pixels = imread(io.BytesIO(base64.b64decode(data_url.partition(",")[2])), format="png")
    return float(pixels[0, 0, :3].mean())


def test_every_picture_is_there_for_a_light_and_for_a_dark_page(written):
    page = Page(written[1])
    light = [a["src"] for tag, a in page.elements if tag == "img"]
    dark = [a["srcset"] for tag, a in page.elements if tag == "source" and a["media"] == "(prefers-color-scheme: dark)"]
    assert len(light) == len(dark) == 2
    assert all(corner(picture) > 0.9 for picture in light)
    assert all(corner(picture) < 0.2 for picture in dark)


def test_it_says_what_failed_when_and_how_well_it_was_located(written):
    _, text = written
    page = Page(text)
    changes = [row for row in page.rows if len(row) == 5 and row[1] == "4"]
    assert [row[3] for row in changes] == ["healthy", "suspect", "failed"]
    assert LOST_S <= float(changes[-1][0]) <= LOST_S + 2.5
    facts = {row[0]: row[1] for row in page.rows if len(row) == 2}
    assert float(facts["without its GPS"].removesuffix(" s")) == pytest.approx(6.0, abs=1.0)
    assert int(facts["GPS_INPUT with a fix"]) > 25
    (line,) = re.findall(r"<p>Readiness of healthy vehicles if their GPS had failed, of all their time: (.*?)\.</p>", text)
    assert sum(map(int, re.findall(r"(\d+)%", line))) == pytest.approx(100, abs=2)
    assert "limited most often by: " in line
    assert "Vehicle 4 without its GPS" in text
    assert "Vehicle 1 without its GPS" not in text


def test_the_map_names_its_origin_and_it_is_that_of_the_live_page(written, tmp_path):
    _, text = written
    write_flight(tmp_path / "f.tlog", 4.0)
    history = read_history(tmp_path / "f.tlog", Settings(), None, None)
    engine = Engine(load_estimator("fleet", {}))
    replay(Replay(engine, TlogReader(tmp_path / "f.tlog"), [], lambda at_s, outputs: None))
    lat_deg, lon_deg, _ = engine.snapshot(history.counts.last_s).origin
    assert (history.frame.lat_deg, history.frame.lon_deg) == (lat_deg, lon_deg)
    assert f"East and north of {lat_deg:.7f}, {lon_deg:.7f}," in text


def test_damage_and_names_are_told_as_they_are(written):
    done, text = written
    assert "truncated: 1; replayed what is whole" in done.stderr
    assert "The file is damaged: truncated: 1" in text
    assert "flight &lt;4&gt;.tlog" in text
    assert "<4>" not in text


def test_a_page_that_cannot_be_written_is_one_line(written, tmp_path):
    path = tmp_path / "f.tlog"
    write_flight(path, 2.0)
    done = gcs_coloc("report", path, "--out", tmp_path / "absent" / "page.html")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "cannot be written" in done.stderr
