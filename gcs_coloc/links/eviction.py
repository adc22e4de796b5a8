"""Eviction: which entry of a full table makes room for a new one.

It is one rule for every table that senders can fill, hostile ones included.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain, takewhile
from typing import TypeVar

Key = TypeVar("Key")


def find_evicted(
    by_age: Iterable[Key], *, is_silent: Callable[[Key], bool], is_proven: Callable[[Key], bool], for_proven: bool
) -> Key | None:
    """Return the entry that makes room for a new one; None where none does.

    `by_age` has the keys, that of the longest silent first. Silent entries go first, among them the unproven ones.
    An entry that is not silent goes only if it is unproven, and only for a proven vehicle (`for_proven`).
    So a flood of new senders keeps no known vehicle out.
    """
    keys = list(by_age)
    silent = list(takewhile(is_silent, keys))
    rest = keys[len(silent) :] if for_proven else []
    candidates = chain((key for key in silent if not is_proven(key)), silent, (key for key in rest if not is_proven(key)))
    return next(candidates, None)
