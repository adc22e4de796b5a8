"""The page of all fleets is served with the strict headers, its health, its metrics and its pictures."""

import asyncio
import contextlib
import json
from dataclasses import replace

import pytest
from fleet_views import HEALTHY, LOST, fleet_view

from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.sinks.fleet_overview import fleet_overview
from gcs_coloc.sinks.watched_fleets import WatchedFleets
from gcs_coloc.web.fleets_page import FLEETS_EVERY_S, FleetsSource, make_fleets_app
from gcs_coloc.web.pages import Pages


@pytest.fixture
def fleets():
    found = WatchedFleets()
    for second in (1.0, 2.0):
        overview = fleet_overview(fleet_view(second, HEALTHY, replace(LOST, sysid=5)), (), host="alpha", every_s=1.0)
        found.receive("north", "north", overview, second, 0.0)
    found.receive_connection("old", "old", None, 2.0, (9,))
    return found


@contextlib.asynccontextmanager
async def nothing(app):
    yield


def source_of(fleets, problem=None):
    return FleetsSource(lambda: fleets.shown(2.5), "MQTT broker x:1883", lambda: problem, lambda: {"watch_unreadable": 3})


def get(source, path, host="127.0.0.1:8081"):
    """Status, headers and text of an answer of the application."""
    app = make_fleets_app(source, Pages(source, IdleScheduler(), FLEETS_EVERY_S), (), nothing)
    scope = {"type": "http", "method": "GET", "path": path, "headers": [(b"host", host.encode())], "query_string": b""}
    messages = []

    async def send(message):
        messages.append(message)

    async def receive():
        await asyncio.Event().wait()  # nothing follows a GET

    asyncio.run(app(scope, receive, send))
    headers = {k.decode(): v.decode() for k, v in messages[0]["headers"]}
    return messages[0]["status"], headers, b"".join(m.get("body", b"") for m in messages[1:]).decode()


@pytest.mark.parametrize("path", ["/", "/static/fleets.js", "/static/fleets.css", "/static/live_connection.js"])
def test_the_page_and_its_files_come_with_the_strict_policy(fleets, path):
    status, headers, _ = get(source_of(fleets), path)
    assert status == 200
    assert headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'; style-src 'self';")


def test_under_a_foreign_name_it_is_refused(fleets):
    assert get(source_of(fleets), "/", "evil.example")[0] == 403


@pytest.mark.parametrize(("problem", "expected"), [(None, 200), ("not connected to x:1883: refused", 503)])
def test_it_is_ready_while_states_can_come_and_says_why_not(fleets, problem, expected):
    source = source_of(fleets, problem)
    assert get(source, "/healthz")[0] == 200
    status, _, text = get(source, "/readyz")
    assert (status, text) == (expected, f"{problem or 'ok'}\n")


def test_the_metrics_count_fleets_vehicles_and_refusals(fleets):
    _, _, text = get(source_of(fleets), "/metrics")
    for line in (
        'gcs_coloc_watch_fleets{presence="live"} 1.0',
        'gcs_coloc_watch_fleets{presence="untold"} 1.0',
        'gcs_coloc_watch_fleets{presence="stale"} 0.0',
        'gcs_coloc_watch_vehicles{light="bad"} 1.0',
        'gcs_coloc_watch_vehicles{light="good"} 1.0',
        "gcs_coloc_watch_connected 1.0",
        'gcs_coloc_watch_refused_total{reason="watch_unreadable"} 3.0',
    ):
        assert f"\n{line}\n" in text, line


def test_a_picture_holds_every_fleet_and_where_the_states_come_from(fleets):
    (text,) = source_of(fleets).messages(with_counts=True)
    picture = json.loads(text)
    assert (picture["kind"], picture["origin"], picture["problem"]) == ("fleets", "MQTT broker x:1883", None)
    assert [(fleet["name"], fleet["presence"]) for fleet in picture["fleets"]] == [("north", "live"), ("old", "untold")]
    assert picture["fleets"][0]["overview"]["vehicles"][0]["lat_deg"] == 47.0
