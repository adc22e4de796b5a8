"""The errors of ranges that no averaging removes.

The residuals of epochs and the fault monitor have the same.
"""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.setting_bounds import between, check_bounds


@dataclass(frozen=True, slots=True)
class RangeErrorSettings:
    """The errors that the ranges of a pair share."""

    range_bias_m: float = between(0.3, 0.0, 100.0)
    """1-sigma of the error that all ranges of a pair share, m. Source: lasting biases of 0.16 to 0.35 m in public
    ultra-wideband data."""
    coloured_share: float = between(0.1, 0.0, 1.0)
    """Share of the stated variance of ranges that no averaging removes. Chosen: as `range_coloured_share` of the fleet filter."""

    def __post_init__(self) -> None:
        check_bounds(self)
