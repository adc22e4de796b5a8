"""A table on a terminal, drawn by a thread of its own: a terminal that takes nothing (Ctrl-S) must not hold the service up."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rich.console import Console, RenderableType
from rich.live import Live

_LAST_TABLE_S = 1.0


class SharedConsole(Console):
    """A console on which one thread draws a table and others print lines above it.

    rich works out how far up the table before begins, then draws: what another thread prints in between would leave a piece of
    that table behind. `turn` is held for as long as either takes.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.turn = threading.RLock()

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, when nobody else does."""
        with self.turn:
            super().print(*objects, **options)


class LiveTable:
    """Always draws the newest of what it was given; what came while the terminal took nothing is left out."""

    def __init__(self, console: SharedConsole) -> None:
        self._console = console
        self._newest: Callable[[], RenderableType] | None = None
        self._wake = threading.Event()
        self._ending = False
        self._drawing = threading.Thread(target=self._draw, name="table", daemon=True)
        self._drawing.start()

    def show(self, make: Callable[[], RenderableType]) -> None:
        """Draw what `make` gives, in place of what was drawn before; never waits. `make` is called on the thread."""
        self._newest = make
        self._wake.set()

    def close(self) -> None:
        """Leave the last table where it is; a terminal that takes nothing is left to itself after a moment."""
        self._ending = True
        self._wake.set()
        self._drawing.join(_LAST_TABLE_S)

    def _draw(self) -> None:
        # Standard output and error stay what they are: they would wait for this very terminal.
        live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
        with self._console.turn:
            live.start()
        while not self._ending:
            self._wake.wait()
            self._wake.clear()
            make, self._newest = self._newest, None
            if make is not None:
                table = make()
                with self._console.turn:
                    live.update(table, refresh=True)
        with self._console.turn:
            live.stop()
