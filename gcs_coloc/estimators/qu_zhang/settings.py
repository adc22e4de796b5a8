"""Settings of the paper's stack."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from gcs_coloc.core.errors import EstimatorError


@dataclass(frozen=True, slots=True)
class QuZhangSettings:
    """Settings of `QuZhang`. Raises EstimatorError for a value that no filter can work with.

    Attributes:
        covariance: of a fix: "corrected" is the first-order covariance of the trilateration, "published" the paper's error
            equation to the letter, "constant" the paper's "general KF".
        constant_sigma_m: 1-sigma per axis of a fix under covariance = "constant".
        q_m2ps2: process noise as in the paper, a velocity variance per step of 0.02 s. The default, 25 m^2/s^3, keeps the lag
            of the filter in a turn of 5 m/s^2 inside about twice its stated sigma for fixes of 2 to 10 m noise at 4 Hz;
            less is smoother on straight legs and wrong in turns.
        q_vertical_m2ps2: the same for the height; the default fits climbs that change by about 1 m/s in a second.
        epoch_window_s: ranges that were measured within this time make one fix.
        epoch_wait_s: an incomplete epoch is closed this long after its first range arrived.
        late_window_s: measurements older than their filter by more than this are dropped; younger late ones count as if they
            had come in order.
        peer_age_limit_s: a peer without a position for longer is not used.
        min_flatness: least height over longest side of the peers' triangle.
        gate_probability: of accepting a measurement that agrees with its stated noise.
        gate_patience: refusals in a row before the filter itself is doubted and its covariance widened.
        lasting_peer_errors: carry the peers' position errors as lasting ones (GPS errors are). False takes them as white, as
            the paper does.
        max_sigma_m: the answer is "unknown" when the horizontal 1-sigma outgrows this.
        max_prediction_s: or when there has been no fix for longer than this.

    """

    covariance: str = "corrected"
    constant_sigma_m: float = 30.0
    q_m2ps2: float = 0.5
    q_vertical_m2ps2: float = 0.02
    epoch_window_s: float = 0.25
    epoch_wait_s: float = 0.5
    late_window_s: float = 1.0
    peer_age_limit_s: float = 3.0
    min_flatness: float = 0.05
    gate_probability: float = 0.9999
    gate_patience: int = 4
    lasting_peer_errors: bool = True
    max_sigma_m: float = 200.0
    max_prediction_s: float = 15.0

    def __post_init__(self) -> None:
        if self.covariance not in ("corrected", "published", "constant"):
            raise EstimatorError(f"covariance is {self.covariance!r}; it must be 'corrected', 'published' or 'constant'")
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, float) and not (math.isfinite(value) and value > 0.0):
                raise EstimatorError(f"{one.name} is {value}; it must be a number above 0")
        if not self.gate_probability < 1.0:
            raise EstimatorError(f"gate_probability is {self.gate_probability}; it must be below 1")
        if self.gate_patience < 0:
            raise EstimatorError(f"gate_patience is {self.gate_patience}; it must not be negative")
