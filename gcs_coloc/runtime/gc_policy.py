"""Keeps the garbage collector out of the flight.

What the flight allocates it frees by itself, hardly anything of it is a cycle. Python's default is to look through what is young
whenever some hundred objects more are alive than before, and now and then through everything: with many fleets that takes a sixth
of the CPU, and can hold up what is to be sent for a quarter of a second.
"""

from __future__ import annotations

import gc

_YOUNG = 50_000
"""So many more objects must be alive before it looks for cycles among them: some 10 MB that cycles may keep for a while."""


def collect_seldom() -> None:
    """Leave out for ever what the start has made, and look through what comes after it seldom."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(_YOUNG, 20, 50)
