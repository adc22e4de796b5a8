"""The WebSocket of an open page, for as long as it is open."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from starlette.websockets import WebSocket, WebSocketDisconnect

from gcs_coloc.web.pages import Pages


async def serve_live(socket: WebSocket, pages: Pages, hello: Callable[[], str]) -> None:
    """Send one page hello, then events and pictures, until it is closed."""
    if pages.full:
        await socket.close(1013, "too many pages are open")
        return
    page = pages.add(hello, socket.send_text)
    sender: asyncio.Task[None] | None = None
    try:
        await socket.accept()
        sender = asyncio.create_task(page.send_all())
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            page.receive(message.get("text"))
    except WebSocketDisconnect:
        pass
    finally:
        pages.remove(page)
        if sender is not None:
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)
