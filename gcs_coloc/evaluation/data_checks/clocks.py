"""Times of a recording's parts held against each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.evidence import Evidence
from gcs_coloc.evaluation.data_checks.finding import DataFinding

_SLOW_S = 20.0
_LATE_S = 10.0
_APART_S = 60.0
_LEAST_NEAR = 0.02


def check_clocks(evidence: Evidence) -> Iterator[DataFinding]:
    """Yield parts that do not overlap in time, and times that can hardly be seconds."""
    ranges_s = evidence.ranges[:, 0]
    if len(ranges_s) == 0:
        return
    for name, tracks in (("reported positions", evidence.reports), ("truth", evidence.truth)):
        times = [track.times_s for track in tracks.values() if not track.is_static]
        if not times:
            continue
        times_s = np.concatenate(times)
        near = (times_s >= ranges_s.min() - _APART_S) & (times_s <= ranges_s.max() + _APART_S)
        if near.mean() < _LEAST_NEAR:
            text = f"{near.mean():.1%} of the {name} ({_span(times_s)}) are of the time of the ranges ({_span(ranges_s)})"
            yield DataFinding("no_overlap", f"only {text}: one clock is wanted, in seconds", float(near.mean()))
    a, b = np.sort(evidence.ranges[:, 1:3], axis=1).T
    order = np.lexsort((ranges_s, b, a))
    same = (np.diff(a[order]) == 0) & (np.diff(b[order]) == 0)
    waits_s = np.diff(ranges_s[order])[same]
    if len(waits_s) and (wait_s := float(np.median(waits_s))) > _SLOW_S:
        yield DataFinding(
            "slow_ranges",
            f"the ranges of a pair come {wait_s:.4g} s after each other in the median: are times in milliseconds?",
            wait_s,
        )


def check_delays(delays_s: Mapping[str, FloatArray]) -> Iterator[DataFinding]:
    """Yield kinds of measurements that arrive far too late to have one clock; `delays_s` by the name of the kind."""
    for name, delays in delays_s.items():
        if len(delays) and (delay_s := float(np.median(delays))) > _LATE_S:
            yield DataFinding(
                "late_arrival",
                f"{name} arrive {delay_s:.4g} s after they were measured in the median: is arrival_s on the clock of t_s?",
                delay_s,
            )


def _span(times_s: FloatArray) -> str:
    return f"{times_s.min():.10g} to {times_s.max():.10g} s"
