"""What a fault of the page does: it ends a program that is nothing without it, and no flight."""

from __future__ import annotations

import asyncio
import logging
from urllib.parse import urlsplit

import pytest

from gcs_coloc.config.service_sections import WebConfig
from gcs_coloc.core.errors import WebError
from gcs_coloc.sinks.event_bus import IdleScheduler
from gcs_coloc.web.fleets_page import FLEETS_EVERY_S, FleetsSource
from gcs_coloc.web.pages import Pages
from gcs_coloc.web.server import WebServer


def serve_with_a_fault(*, must_serve: bool) -> None:
    """Serve a page on any free port whose background task fails, until it ends or is ended."""

    async def serve() -> None:
        async def fault() -> None:
            failed.set()
            raise OSError("no space is left")

        failed, source = asyncio.Event(), FleetsSource(tuple, "test")
        pages = Pages(source, IdleScheduler(), FLEETS_EVERY_S)
        server = WebServer(WebConfig(address="127.0.0.1:0"), source, pages, fault, must_serve=must_serve)
        server.open()
        serving = asyncio.create_task(server.run())
        await failed.wait()
        if not must_serve:
            server.stop()
        await serving

    asyncio.run(serve())


def test_a_page_that_is_all_there_is_ends_with_what_is_wrong_and_the_remedy():
    with pytest.raises(WebError, match=r"^web page: stands still: OSError: no space is left; start the program again$"):
        serve_with_a_fault(must_serve=True)


def test_a_flight_goes_on_without_its_page_and_the_log_says_so(caplog):
    with caplog.at_level(logging.ERROR, "gcs_coloc"):
        serve_with_a_fault(must_serve=False)
    assert caplog.messages == ["web page: stands still: OSError: no space is left; the flight goes on without it"]


def test_a_server_does_not_look_whether_it_is_to_end_and_ends_when_it_is_told(monkeypatch):
    pauses_s, sleep = [], asyncio.sleep

    def note(pause_s: float):
        pauses_s.append(pause_s)
        return sleep(0)

    async def serve() -> None:
        source = FleetsSource(tuple, "test")
        server = WebServer(WebConfig(address="127.0.0.1:0"), source, Pages(source, IdleScheduler(), FLEETS_EVERY_S))
        url = urlsplit(server.open())
        serving = asyncio.create_task(server.run())
        reader, writer = await asyncio.open_connection(url.hostname, url.port)
        writer.write(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        assert (await reader.read()).startswith(b"HTTP/1.1 200")
        writer.close()
        assert not any(pauses_s)
        server.stop()
        await serving

    monkeypatch.setattr(asyncio, "sleep", note)
    asyncio.run(serve())
