"""Settings of the estimator of Qu & Zhang."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from gcs_coloc.core.setting_bounds import between, check_bounds

Covariance = Literal["corrected", "published", "constant"]


@dataclass(frozen=True, slots=True)
class QuZhangSettings:
    """Settings of `QuZhangFilter`.

    Raises:
        ValueError: a value is out of its bounds; the text names it.

    """

    covariance: Covariance = "corrected"
    """Covariance of a fix: `corrected` is the first-order covariance of the trilateration, `published` the paper's Eq. 23 to 26
    to the letter, `constant` one for all, the paper's "general KF". Chosen: the only one that is honest in every geometry."""
    constant_sigma_m: float = between(30.0, 1e-3, 1e4)
    """m. 1-sigma of a fix per axis under `covariance = "constant"`. The paper gives none.
    Chosen: its range noise of 20 m (Table 1) at an HDOP of 1.5."""
    q_m2ps2: float = between(0.5, 1e-6, 1e4)
    """m^2/s^2. Process noise as the paper states it (Eq. 38): variance of each velocity per step of 0.02 s.
    Larger follows turns faster and is noisier on straight legs. The paper varies it from 0 to 100 (Table 2).
    Chosen: 25 m^2/s^3, which keeps the lag in a turn of 5 m/s^2 inside about twice the stated sigma for fixes of 2 to 10 m noise
    at 4 Hz."""
    q_vertical_m2ps2: float = between(0.02, 1e-6, 1e4)
    """m^2/s^2. The same for the height. Chosen: climbs that change by about 1 m/s in a second."""
    epoch_window_s: float = between(0.25, 1e-3, 60.0)
    """s. Ranges measured within this time make one fix. Chosen: a radio that ranges four peers at 20 Hz."""
    epoch_wait_s: float = between(0.5, 1e-3, 60.0)
    """s. An incomplete epoch is closed so long after its first range arrived. Longer makes fixes older. Chosen: the
    jitter of a telemetry radio."""
    late_window_s: float = between(1.0, 1e-3, 60.0)
    """s. A measurement older than its filter by more is dropped; a younger late one counts as if it had come in
    order. Longer costs memory and CPU time. Chosen: the delay of telemetry over a mobile network."""
    peer_age_limit_s: float = between(3.0, 1e-3, 600.0)
    """s. A peer without a position for longer is not used. Chosen: three lost reports at 1 Hz."""
    min_flatness: float = between(0.05, 1e-3, 0.866)
    """Ratio. Least height of the peers' triangle over its longest side; 0.866 is equilateral. The paper excludes
    collinear peers (H of Eq. 16 is singular). Chosen: the fix is some 20 times less certain across the line than along."""
    gate_probability: float = between(0.9999, 0.5, 1.0)
    """Probability. A measurement that agrees with its stated noise passes so often; at 1 there is no gate. Chosen: one
    needless refusal in 10,000."""
    gate_patience: int = between(4, 0, 1000)
    """Count. Refusals in a row before the filter's own covariance is inflated until fixes pass again. Chosen: one
    second at 4 Hz; fewer let a burst of reflections in."""
    lasting_peer_errors: bool = True
    """Whether the peers' position errors last from fix to fix and are carried in the covariance; `false` takes them as new each
    time, as the paper does. Chosen: those of GPS last for minutes."""
    max_sigma_m: float = between(200.0, 0.01, 1e6)
    """m. Beyond this horizontal sigma (largest axis) there is no estimate. Chosen: no autopilot can use more."""
    max_prediction_s: float = between(15.0, 0.01, 3600.0)
    """s. There is no estimate when the last fix is older. Chosen: at 5 m/s^2 unknown, 560 m off."""

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.covariance not in (known := get_args(Covariance)):
            raise ValueError(f"covariance must be {' or '.join(map(repr, known))}, not {self.covariance!r}")
