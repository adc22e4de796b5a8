"""Ranges that stand in a recording more than once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gcs_coloc.evaluation.data_checks.evidence import Evidence
from gcs_coloc.evaluation.data_checks.finding import DataFinding


def check_repeats(evidence: Evidence) -> Iterator[DataFinding]:
    """Yield how many ranges have time, vehicles and value of another one: each counts as a measurement of its own."""
    if len(evidence.ranges) == 0:
        return
    pair = np.sort(evidence.ranges[:, 1:3], axis=1)
    keys = np.column_stack((evidence.ranges[:, 0], pair, evidence.ranges[:, 3]))
    keys = keys[np.lexsort(keys.T)]
    count = int((keys[1:] == keys[:-1]).all(axis=1).sum())
    if count:
        yield DataFinding(
            "repeated_ranges",
            f"{count} ranges stand there twice, with the same time, vehicles and value: each counts as a measurement of its own "
            "and makes the result look more certain than it is",
            count,
        )
