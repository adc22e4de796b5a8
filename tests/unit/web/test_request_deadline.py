"""A request that never comes to its end holds no place for those that do."""

from __future__ import annotations

import asyncio
import contextlib

import pytest
import uvicorn
from websockets.asyncio.client import connect

from gcs_coloc.web import server as web_server
from gcs_coloc.web.server import MAX_HALF_OPEN, RequestDeadline

PATIENCE_S = 60.0


async def hello(scope, receive, send):
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await send({"type": "websocket.send", "text": (await receive())["text"]})
        return
    if scope["path"] == "/body" and (await receive())["more_body"]:
        await receive()
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"5")]})
    await send({"type": "http.response.body", "body": b"hello"})


async def served(scenario):
    config = uvicorn.Config(hello, port=0, http=RequestDeadline, lifespan="off", log_config=None, limit_concurrency=64)
    server = uvicorn.Server(config)
    serving = asyncio.create_task(server.serve())
    while not server.started:  # noqa: ASYNC110 - uvicorn tells it in no other way
        await asyncio.sleep(0.001)
    try:
        await asyncio.wait_for(scenario(server.servers[0].sockets[0].getsockname()[1]), PATIENCE_S)
    finally:
        server.should_exit = True
        await serving


async def ended(reader):
    """Whether the connection was ended with nothing to read."""
    with contextlib.suppress(ConnectionResetError):
        return await reader.read() == b""
    return True


async def answer(port):
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    text = await reader.read()
    writer.close()
    return text


def test_half_open_requests_of_one_host_do_not_shut_the_page():
    async def scenario(port):
        idle = [await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0)) for _ in range(100)]
        for _, writer in idle:
            writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n")
        assert all([await ended(reader) for reader, _ in idle[MAX_HALF_OPEN:]])
        assert (await answer(port)).endswith(b"hello")
        for _, writer in idle:
            writer.close()

    asyncio.run(served(scenario))


HEADER = b"GET / HTTP/1.1\r\nHost: x\r\n"
UNFINISHED_BODY = b"POST /body HTTP/1.1\r\nHost: x\r\nContent-Length: 4\r\n\r\n12"


@pytest.mark.parametrize("sent", [b"", HEADER, UNFINISHED_BODY])
def test_a_request_that_is_not_finished_in_time_ends_the_connection(monkeypatch, sent):
    monkeypatch.setattr(web_server, "ANSWERED_WITHIN_S", 0.05)

    async def scenario(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(sent)
        assert await ended(reader)
        writer.close()
        assert (await answer(port)).endswith(b"hello")

    asyncio.run(served(scenario))


def test_a_second_request_that_is_not_finished_in_time_ends_the_connection(monkeypatch):
    """Where an answer leaves the connection open, as uvicorn's own may."""
    monkeypatch.setattr(web_server, "ANSWERED_WITHIN_S", 0.5)

    async def scenario(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(HEADER + b"\r\n")
        await reader.readuntil(b"hello")
        writer.write(HEADER)
        assert await ended(reader)
        writer.close()

    asyncio.run(served(scenario))


def test_a_web_socket_has_no_deadline(monkeypatch):
    monkeypatch.setattr(web_server, "ANSWERED_WITHIN_S", 0.5)

    async def scenario(port):
        async with connect(f"ws://127.0.0.1:{port}/") as socket:
            assert not RequestDeadline._half_open
            await asyncio.sleep(0.7)
            await socket.send("still there?")
            assert await socket.recv() == "still there?"

    asyncio.run(served(scenario))


def test_a_header_in_pieces_is_answered():
    async def scenario(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for piece in (b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r", b"\n\r", b"\n"):
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0)
        assert (await reader.read()).endswith(b"hello")
        writer.close()

    asyncio.run(served(scenario))
