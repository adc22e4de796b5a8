"""The policy of garbage collection (GC): none that holds the flight up.

Reference counting frees nearly everything that a flight allocates; hardly any of it is a cycle. By default Python searches the
young objects whenever 700 more are alive than before, and now and then all objects. With many fleets that takes a sixth of the
CPU, and can delay an output by a quarter of a second.
"""

from __future__ import annotations

import gc

_YOUNG_OBJECTS = 50_000
"""New objects before they are searched for cycles. Chosen: cycles may keep some 10 MB for a while."""
_YOUNG_SEARCHES = 20
"""Searches of the young objects before one of the middle generation. Chosen: twice Python's default."""
_MIDDLE_SEARCHES = 50
"""Searches of the middle generation before one of all objects. Chosen: five times Python's default."""


def collect_seldom() -> None:
    """Exclude all objects of the start for ever, and search later ones seldom."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(_YOUNG_OBJECTS, _YOUNG_SEARCHES, _MIDDLE_SEARCHES)
