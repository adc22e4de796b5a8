"""The floor under what observers cost: as many bytes as often, through the same libraries, from a program that does nothing else.

`python -m bench.observer_floor MQTT_PORT FOLDER` says where its page is, and goes on until it is ended.
"""

from __future__ import annotations

import asyncio
import math
import os
import signal
import socket
import sys
import threading
from pathlib import Path

import uvicorn
from aiomqtt import Client
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket

# As a fleet of four makes them: a picture, a vehicle's topic, a second of tlog and of MCAP.
_PICTURE = "x" * 8_300
_PAYLOAD = "x" * 380
_TOPICS = 18
_WRITTEN = (b"x" * 8_000, b"x" * 47_000)
_pages: list[WebSocket] = []
_PICTURE_EVERY_S, _PUBLISH_EVERY_S, _WRITE_EVERY_S = 0.4, 1.0, 1.0


async def _live(page: WebSocket) -> None:
    await page.accept()
    _pages.append(page)
    await asyncio.Event().wait()


async def _show() -> None:
    while True:
        for page in _pages:
            await page.send_text(_PICTURE)
        await asyncio.sleep(_PICTURE_EVERY_S)


async def _publish(port: int) -> None:
    async with Client("127.0.0.1", port) as client:
        client.pending_calls_threshold = _TOPICS  # no line for each that waits
        while True:
            topics = (f"floor/{number}" for number in range(_TOPICS))
            await asyncio.gather(*(client.publish(topic, _PAYLOAD, retain=True, timeout=math.inf) for topic in topics))
            await asyncio.sleep(_PUBLISH_EVERY_S)


def _record(folder: Path) -> None:
    files = [(folder / f"floor-{len(data)}").open("wb", buffering=0) for data in _WRITTEN]
    pause = threading.Event()
    while True:
        pause.wait(_WRITE_EVERY_S)
        for file, data in zip(files, _WRITTEN, strict=True):
            file.write(data)
            os.fdatasync(file.fileno())


async def _run(mqtt_port: int, folder: Path) -> None:
    threading.Thread(target=_record, args=(folder,), daemon=True).start()
    where = socket.create_server(("127.0.0.1", 0))
    print(f"web page: http://127.0.0.1:{where.getsockname()[1]}/", flush=True)
    app = Starlette(routes=[WebSocketRoute("/live", _live)])

    async def tick_once() -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # uvicorn looks for it at its ticks
        await asyncio.Event().wait()

    config = uvicorn.Config(
        app, http="h11", ws_per_message_deflate=False, lifespan="off", log_config=None, callback_notify=tick_once
    )
    server = uvicorn.Server(config)
    async with asyncio.TaskGroup() as group:
        group.create_task(_publish(mqtt_port))
        group.create_task(_show())
        group.create_task(server.serve(sockets=[where]))


if __name__ == "__main__":
    asyncio.run(_run(int(sys.argv[1]), Path(sys.argv[2])))
