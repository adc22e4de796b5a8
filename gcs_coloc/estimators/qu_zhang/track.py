"""The track of one vehicle from its own sensors.

It is a horizontal and a vertical constant-velocity filter (Qu & Zhang, Eq. 27-31).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType

import numpy as np
from scipy.stats import chi2

from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, PositionMeasurement
from gcs_coloc.estimators.qu_zhang.cv_filter import CvFilter, Sensitivities, nis, position_rows, velocity_rows

UNKNOWN_SPEED_SIGMA_MPS = 30.0
"""1-sigma of each axis of an unknown velocity. Chosen: any aircraft that ranges between vehicles are used for."""
_UNKNOWN_CLIMB_SIGMA_MPS = 5.0  # 1-sigma of an unknown climb rate; chosen: the climb limit of small aircraft
_INFLATION = 4.0
"""Of the covariance. Chosen: it doubles the standard deviation, so ten refusals cover an error of a thousand sigmas."""


@dataclass(frozen=True, slots=True)
class GateResult:
    """What to do with one measurement.

    `inflation` is the factor, >= 1, by which the filter's covariance is to be multiplied now; above 1 only with a refusal.
    """

    accepted: bool
    inflation: float


@dataclass(slots=True)
class NisGate:
    """Tests one filter's measurements of one kind.

    `probability` is that of accepting a measurement that agrees with its stated noise; `patience` is how many refusals in a row
    are blamed on the measurements before the filter's covariance is inflated.
    """

    probability: float
    patience: int
    refused_in_a_row: int = field(default=0, init=False)

    def test(self, nis: float, degrees_of_freedom: int) -> GateResult:
        """Accept or refuse a measurement of the given NIS (a plain number). A NaN is refused."""
        if nis <= threshold(self.probability, degrees_of_freedom):
            self.refused_in_a_row = 0
            return GateResult(accepted=True, inflation=1.0)
        self.refused_in_a_row += 1
        return GateResult(accepted=False, inflation=_INFLATION if self.refused_in_a_row > self.patience else 1.0)


@cache
def threshold(probability: float, degrees_of_freedom: int) -> float:
    """Return the chi-square quantile that a consistent measurement's NIS stays below with a probability."""
    return float(chi2.ppf(probability, degrees_of_freedom))


class PeerTrack:
    """The filters of one vehicle, and the sigmas that its receiver stated last.

    The densities are those of white acceleration, the gate's values as `NisGate` has them. A measurement may be late by
    `memory_s`.
    """

    def __init__(
        self, density_m2ps3: float, vertical_density_m2ps3: float, gate_probability: float, gate_patience: int, memory_s: float
    ) -> None:
        self._memory_s = memory_s
        self._density = density_m2ps3
        self._vertical_density = vertical_density_m2ps3
        self._gate = NisGate(gate_probability, gate_patience)
        self._vertical_gate = NisGate(gate_probability, gate_patience)
        self.horizontal: CvFilter | None = None
        self.vertical: CvFilter | None = None
        self.position_at_s = -math.inf
        self.static = False
        self.sigma_h_m = 0.0
        self.sigma_v_m = 0.0

    def position_age_s(self, at_s: float) -> float:
        """Return how old the newest position is at a time; that of a fixed anchor does not age."""
        return 0.0 if self.static else at_s - self.position_at_s

    def height_variance_m2(self, at_s: float) -> float:
        """Return the variance of its height at a time, m^2, with the part that lasts; else infinite."""
        return math.inf if self.vertical is None else float(self.vertical.predicted(at_s)[1][0, 0]) + self.sigma_v_m**2

    def start(self, measurement: PositionMeasurement) -> None:
        """Initialise the filters from one position."""
        self.static = measurement.static
        east_north, up = np.array(measurement.position_enu_m[:2]), np.array(measurement.position_enu_m[2:])
        at_s = measurement.measured_at_s
        velocity, sigma = measurement.velocity_enu_mps, measurement.sigma_velocity_mps
        if self.static:
            horizontal_sigma, climb_sigma, velocity = 0.0, 0.0, (0.0, 0.0, 0.0)
        elif velocity is None or sigma is None:
            horizontal_sigma, climb_sigma, velocity = UNKNOWN_SPEED_SIGMA_MPS, _UNKNOWN_CLIMB_SIGMA_MPS, (0.0, 0.0, 0.0)
        else:
            horizontal_sigma, climb_sigma = sigma, sigma
        self.start_horizontal(at_s, east_north, measurement.sigma_h_m**2 * np.eye(2), np.array(velocity[:2]), horizontal_sigma)
        self._start_vertical(at_s, up, measurement.sigma_v_m, np.array(velocity[2:]), climb_sigma)
        self._remember(measurement)

    def start_horizontal(
        self,
        at_s: float,
        position_m: FloatArray,
        covariance: FloatArray,
        velocity_mps: FloatArray | None = None,
        velocity_sigma_mps: float = UNKNOWN_SPEED_SIGMA_MPS,
        sensitivities: Sensitivities = MappingProxyType({}),
    ) -> None:
        """Begin the horizontal filter anew from a position (2,) and a velocity (2,), None where unknown."""
        velocity = np.zeros(2) if velocity_mps is None else velocity_mps
        self.horizontal = CvFilter(
            at_s,
            position_m,
            covariance,
            velocity,
            velocity_sigma_mps**2,
            0.0 if self.static else self._density,
            memory_s=self._memory_s,
            sensitivities=sensitivities,
        )

    def add_position(self, measurement: PositionMeasurement) -> bool:
        """Update with a position, and velocity where known, or start; return whether the gate let it pass."""
        if self.horizontal is None or self.vertical is None:
            self.start(measurement)
            return True
        velocity, sigma = measurement.velocity_enu_mps, measurement.sigma_velocity_mps
        values = [np.array(measurement.position_enu_m)]
        variances = [np.array([measurement.sigma_h_m**2] * 2 + [measurement.sigma_v_m**2])]
        rows = [position_rows]
        if velocity is not None and sigma is not None and not self.static:
            values.append(np.array(velocity))
            variances.append(np.full(3, sigma**2))
            rows.append(velocity_rows)
        at_s = measurement.measured_at_s
        accepted = True
        for one, gate, axes in ((self.horizontal, self._gate, [0, 1]), (self.vertical, self._vertical_gate, [2])):
            z = np.concatenate([value[axes] for value in values])
            R = np.diag(np.concatenate([variance[axes] for variance in variances]))
            H = np.vstack([row(len(axes)) for row in rows])
            accepted &= _gated_update(one, gate, z, R, H, at_s)
        if accepted:
            self._remember(measurement)
        return accepted

    def add_altitude(self, measurement: AltitudeMeasurement) -> bool:
        """Take a height; return whether the gate let it pass. Starts the vertical filter if there is none."""
        at_s, up = measurement.measured_at_s, np.array([measurement.up_m])
        if self.vertical is None:
            self._start_vertical(at_s, up, measurement.sigma_m, np.zeros(1), _UNKNOWN_CLIMB_SIGMA_MPS)
            accepted = True
        else:
            R = np.array([[measurement.sigma_m**2]])
            accepted = _gated_update(self.vertical, self._vertical_gate, up, R, position_rows(1), at_s)
        if accepted:
            self.sigma_v_m = measurement.sigma_m
        return accepted

    def _start_vertical(self, at_s: float, up_m: FloatArray, sigma_m: float, climb_mps: FloatArray, sigma_mps: float) -> None:
        variance = np.array([[sigma_m**2]])
        density = 0.0 if self.static else self._vertical_density
        self.vertical = CvFilter(at_s, up_m, variance, climb_mps, sigma_mps**2, density, memory_s=self._memory_s)

    def _remember(self, measurement: PositionMeasurement) -> None:
        self.position_at_s = max(self.position_at_s, measurement.measured_at_s)
        self.sigma_h_m, self.sigma_v_m = measurement.sigma_h_m, measurement.sigma_v_m


def _gated_update(one: CvFilter, gate: NisGate, z: FloatArray, R: FloatArray, H: FloatArray, at_s: float) -> bool:
    result = gate.test(nis(*one.innovation(z, R, H, at_s)), len(z))
    if result.accepted:
        one.update(z, R, H, at_s)
    elif result.inflation > 1.0:
        one.inflate_covariance(result.inflation)
    return result.accepted
