"""What the paper leaves open, as options with defaults, and the figures that it prints."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from gcs_coloc.core.errors import UsageError


class QForm(StrEnum):
    """What the process noise of a step is.

    VELOCITY: the paper's q on velocity alone. ACCELERATION: white acceleration of the same density.
    """

    VELOCITY = "velocity"
    ACCELERATION = "acceleration"


class QUnit(StrEnum):
    """What q counts.

    PER_STEP: a velocity variance per step, m^2/s^2, as the paper writes it. DENSITY: a spectral density, m^2/s^3.
    """

    PER_STEP = "per-step"
    DENSITY = "density"


class ConstantR(StrEnum):
    """How the general filter's R follows from the fix's errors in Monte Carlo.

    VARIANCE: it is their variance. ROBUST: it is a variance from their median absolute deviation, which outliers do not move.
    """

    ROBUST = "robust"
    VARIANCE = "variance"


PUBLISHED_TABLE_2: dict[float, tuple[float, float]] = {
    0: (1920.0, 2310.0),
    1: (10.110, 18.780),
    2: (11.997, 14.387),
    3: (13.055, 13.534),
    4: (13.554, 12.530),
    5: (14.547, 12.387),
    10: (17.273, 13.339),
    20: (20.801, 15.283),
    50: (25.824, 18.642),
    100: (30.347, 21.633),
}
"""Table 2: by q, the variance (m^2) of UAV4's distance error with the general filter and with the proposed method."""


@dataclass(frozen=True, slots=True)
class PaperOptions:
    """One reading of the paper's simulation. Raises UsageError for values that make no run.

    Attributes:
        seeds: number of noise draws; draw i has the seed `first_seed` + i.
        first_seed: seed of the first draw.
        qs: values of q.
        figure_q: the q that figures are drawn for; one of `qs`.
        step_s: computing cycle. The paper prints 0.02 ms; only 0.02 s fits 6 minutes of flight.
        duration_s: length of the flight.
        speed_mps: airspeed of all four.
        gps_sigma_m: white GPS noise per axis.
        range_sigma_m: white range noise.
        end_of_route: what a UAV does after its last waypoint, which three of the four reach: "straight", "loop" or "hold".
        q_form: what a step's process noise is.
        q_unit: what q counts.
        constant_r: how the general filter's R is chosen.
        start_speed_sigma_mps: noise of the one velocity per axis that each filter starts from, beside its first GPS position.
        first_part_s: results are given for this long a first part, too, before the peers come into one line.
        fleet_seeds: the project's own fleet filter is run on at most this many of the draws; each takes it minutes.

    """

    seeds: int = 20
    first_seed: int = 1
    qs: tuple[float, ...] = tuple(PUBLISHED_TABLE_2)
    figure_q: float = 5.0
    step_s: float = 0.02
    duration_s: float = 360.0
    speed_mps: float = 50.0
    gps_sigma_m: float = 15.0
    range_sigma_m: float = 20.0
    end_of_route: str = "straight"
    q_form: QForm = QForm.VELOCITY
    q_unit: QUnit = QUnit.PER_STEP
    constant_r: ConstantR = ConstantR.ROBUST
    start_speed_sigma_mps: float = 1.0
    first_part_s: float = 100.0
    fleet_seeds: int = 2

    def __post_init__(self) -> None:
        if self.seeds < 1 or self.fleet_seeds < 0:
            raise UsageError("the study needs at least 1 seed, and not less than 0 seeds for the fleet filter")
        if not self.qs or min(self.qs) < 0.0 or self.figure_q not in self.qs:
            raise UsageError("the study needs values of q, none below 0, with the one for the figures among them")
        positive = (
            self.step_s,
            self.duration_s,
            self.speed_mps,
            self.gps_sigma_m,
            self.range_sigma_m,
            self.start_speed_sigma_mps,
        )
        if min(positive) <= 0.0 or self.duration_s < 2.0 * self.step_s:
            raise UsageError("step, duration, speed and sigmas of the study must be above 0, and the flight longer than a step")
        if self.end_of_route not in ("straight", "loop", "hold"):
            raise UsageError(f"end of route is {self.end_of_route!r}; it must be straight, loop or hold")
