"""Signals that end a program in order."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Have Ctrl-C, SIGTERM and SIGHUP call `stop`, in the event loop that runs.

    SIGHUP: the terminal was closed or its connection broke, and the aided vehicles must learn of it. Under nohup, which has it
    ignored, the flight goes on.
    """
    ending = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        ending.append(signal.SIGHUP)
    for sign in ending:
        asyncio.get_running_loop().add_signal_handler(sign, stop)
