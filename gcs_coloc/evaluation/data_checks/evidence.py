"""The data of a recording, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.evaluation.data_checks.tracks import PositionTrack


@dataclass(frozen=True, slots=True)
class Evidence:
    """What there is to be compared, by vehicle number.

    `names`: what each vehicle is called. `reports`: what each says of its position, anchors too. `truth`: where each was.
    `ranges` (N, 5): time in s, the two vehicles, range and sigma in m. `altitudes`: of each vehicle (T, 3): time in s, height and
    sigma in m. `origin_height_m`: that of the origin, where heights were brought into the frame from above mean sea level.
    """

    names: Mapping[int, str]
    reports: Mapping[int, PositionTrack]
    truth: Mapping[int, PositionTrack]
    ranges: FloatArray
    altitudes: Mapping[int, FloatArray] = field(default_factory=dict)
    origin_height_m: float = 0.0


def thinned(rows: FloatArray, most: int) -> FloatArray:
    """Not more than `most` of the rows, evenly."""
    return rows if len(rows) <= most else rows[np.linspace(0, len(rows) - 1, most).astype(int)]
