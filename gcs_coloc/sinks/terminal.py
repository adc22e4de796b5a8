"""The terminal on which one thread draws a live table, and others print lines above it."""

from __future__ import annotations

import threading
from typing import Any

from rich.console import Console, RenderableType
from rich.live import Live

_LAST_TABLE_S = 1.0
"""How long the end of the program waits for the last table. Chosen: a slow terminal, and no longer than a person waits."""


class SharedConsole(Console):
    """A console on which one thread draws a table and others print lines above it.

    rich works out how far up the table before begins, then draws: what another thread prints in between would leave a piece of
    that table behind. `lock` is held while either is under way.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.lock = threading.RLock()

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, while nobody else prints."""
        with self.lock:
            super().print(*objects, **options)


class LiveTable:
    """Always draws the newest table; those that came while the terminal was stopped are left out."""

    def __init__(self, console: SharedConsole) -> None:
        self._console = console
        self._newest: RenderableType | None = None
        self._wake = threading.Event()
        self._ending = False
        self._drawing = threading.Thread(target=self._draw, name="table", daemon=True)
        self._drawing.start()

    def show(self, table: RenderableType) -> None:
        """Draw a table in place of the one before; never waits. It is rendered on the thread."""
        self._newest = table
        self._wake.set()

    def close(self) -> None:
        """End with the last table on the screen; a terminal that is stopped is given up after a moment."""
        self._ending = True
        self._wake.set()
        self._drawing.join(_LAST_TABLE_S)

    def _draw(self) -> None:
        # Standard output and error stay what they are: they would wait for this very terminal.
        live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
        with self._console.lock:
            live.start()
        while not self._ending:
            self._wake.wait()
            self._wake.clear()
            table, self._newest = self._newest, None
            if table is not None:
                with self._console.lock:
                    live.update(table, refresh=True)
        with self._console.lock:
            live.stop()
