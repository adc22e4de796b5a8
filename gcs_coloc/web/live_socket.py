"""One WebSocket frame for many pages: made once, and handed to each page's connection without a task's turn."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from typing import Any

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode
from websockets.protocol import State

_EXTENSION = "gcs_coloc.frame"

SendFrame = Callable[[bytes], bool]
"""Hands whole frames to the system now; False, and nothing sent, where the system has not yet taken what was sent before."""


class LiveSocket(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket connection, with `send_frame_of` in its ASGI scope."""

    async def run_asgi(self) -> None:
        """As uvicorn does, the connection's `SendFrame` among the extensions of its scope."""
        self.scope["extensions"][_EXTENSION] = {"send": self._send_frame}
        await super().run_asgi()

    def _send_frame(self, frame: bytes) -> bool:
        if self.conn.state is not State.OPEN or self.transport.is_closing() or self.transport.get_write_buffer_size():
            return False
        self.transport.write(frame)
        return True


def send_frame_of(scope: MutableMapping[str, Any]) -> SendFrame:
    """The way for frames of the connection that an ASGI scope is of, which a `LiveSocket` serves."""
    send: SendFrame = scope["extensions"][_EXTENSION]["send"]
    return send


def text_frame(text: bytes) -> bytes:
    """A text message (UTF-8) as the one frame that a server sends of it: not masked, not compressed."""
    return Frame(Opcode.TEXT, text).serialize(mask=False)
