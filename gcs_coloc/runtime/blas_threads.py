"""Keeps the linear algebra libraries to one thread each.

The filter's matrices have some 100 rows: several threads take longer for them than one, and on a busy machine many times the
CPU. The libraries read these variables when numpy is imported, which is why the entry points call this before anything else.
"""

from __future__ import annotations

import os

_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def one_thread() -> None:
    """Limit them in this process and its children; what the user has set stays. To be called before numpy is imported."""
    for name in _VARIABLES:
        os.environ.setdefault(name, "1")
