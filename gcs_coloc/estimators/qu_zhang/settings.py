"""Settings of the estimator of Qu & Zhang."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from gcs_coloc.estimators.validation import Bounds, check_settings


@dataclass(frozen=True, slots=True)
class QuZhangSettings:
    """Settings of `QuZhangFilter`. Raises EstimatorError for a value that no filter can work with."""

    covariance: Literal["corrected", "published", "constant"] = "corrected"
    """Covariance of a fix: `corrected` is the first-order covariance of the trilateration, `published` the paper's Eq. 23 to 26
    to the letter, `constant` one for all, the paper's "general KF"."""
    constant_sigma_m: Annotated[float, Bounds(above=0.0)] = 30.0
    """1-sigma of a fix per axis under `covariance = "constant"`, m. The paper gives none; chosen: range noise of 20 m (Table 1)
    times an HDOP of 1.5."""
    q_m2ps2: Annotated[float, Bounds(above=0.0)] = 0.5
    """Process noise as the paper states it (Eq. 38): variance of each velocity per step of 0.02 s, m²/s². Larger follows turns
    faster and is noisier on straight legs. The paper varies it from 0 to 100 (Table 2); chosen: 25 m²/s³, which keeps the lag of
    the filter in a turn of 5 m/s² inside about twice its stated sigma for fixes of 2 to 10 m noise at 4 Hz."""
    q_vertical_m2ps2: Annotated[float, Bounds(above=0.0)] = 0.02
    """The same for the height, m²/s². Chosen: climbs that change by about 1 m/s in a second."""
    epoch_window_s: Annotated[float, Bounds(above=0.0)] = 0.25
    """Ranges measured within this time make one fix, s. Chosen: one round of a radio that ranges four peers at 20 Hz."""
    epoch_wait_s: Annotated[float, Bounds(above=0.0)] = 0.5
    """An incomplete epoch is closed this long after its first range arrived, s. Chosen: the jitter of a
    telemetry radio; longer makes fixes older."""
    late_window_s: Annotated[float, Bounds(above=0.0)] = 1.0
    """A measurement older than its filter by more than this is dropped, s; younger late ones count as if they had come in order.
    Chosen: the delay of telemetry over a mobile network; longer costs memory and CPU time."""
    peer_age_limit_s: Annotated[float, Bounds(above=0.0)] = 3.0
    """A peer without a position for longer is not used, s. Chosen: three reports at 1 Hz lost."""
    min_flatness: Annotated[float, Bounds(above=0.0, below=0.8661)] = 0.05
    """Least height of the peers' triangle over its longest side, without a unit; 0.866 is equilateral. The paper excludes
    collinear peers (H of Eq. 16 is singular). Chosen: at 0.05 the fix is some 20 times less certain across the line."""
    gate_probability: Annotated[float, Bounds(above=0.0, below=1.0)] = 0.9999
    """Probability that a measurement passes which agrees with its stated noise. Chosen: one refusal without need in 10 000."""
    gate_patience: Annotated[int, Bounds(least=0)] = 4
    """Refusals in a row before the filter's own covariance is inflated until fixes pass again, a count. Chosen: one second at
    4 Hz; fewer let a burst of reflections in."""
    lasting_peer_errors: bool = True
    """Whether the peers' position errors last from fix to fix (those of GPS do) and are carried in the covariance; `false` takes
    them as new each time, as the paper does."""
    max_sigma_m: Annotated[float, Bounds(above=0.0)] = 200.0
    """There is no estimate when the horizontal 1-sigma outgrows this, m. Chosen: beyond it a position directs nobody."""
    max_prediction_s: Annotated[float, Bounds(above=0.0)] = 15.0
    """There is no estimate when the last fix is older than this, s. Chosen: at 5 m/s² of unknown acceleration 15 s are 560 m."""

    def __post_init__(self) -> None:
        check_settings(self)
