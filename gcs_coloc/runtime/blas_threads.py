"""Keeps the linear algebra libraries to one thread each.

For the filter's matrices of some 100 rows, several threads are slower than one, and on a busy machine they need many times
the CPU. The libraries read these variables when numpy is imported, so the entry points call `one_thread` before anything else.
"""

from __future__ import annotations

import os

_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def one_thread() -> None:
    """Limit them in this process and its children, before numpy is imported. Variables that the user has set stay."""
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
