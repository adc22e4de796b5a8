"""What the fleet filter remembers of one vehicle beside its states."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeVar

from gcs_coloc.core.measurements import AttitudeMeasurement, Measurement, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet_noise import Whiteness

_RECENT_S = 3.0
_RECENT_MOST = 64
_RANGES_S = 4.0
_RANGES_MOST = 120


_Slotted = TypeVar("_Slotted", "ManoeuvreMonitor", "VehicleRecord")


def _same_fields(one: _Slotted) -> _Slotted:
    """Return a shallow copy, in a fifth of the time of `dataclasses.replace`: ten are taken of every vehicle a second."""
    other = object.__new__(type(one))
    for name in one.__slots__:
        setattr(other, name, getattr(one, name))
    return other


@dataclass(slots=True)
class ManoeuvreMonitor:
    """Compares the velocity corrections made with those that the model foresees, horizontally and vertically.

    The corrections are white under a right model, their covariance is known: their fading sum c has the fading sum C as its
    covariance, and c' C^-1 c / 2 has mean 1. A turn that the model does not know makes it large within a second or two.
    """

    c_e: float = 0.0
    c_n: float = 0.0
    C_ee: float = 0.0
    C_en: float = 0.0
    C_nn: float = 0.0
    c_u: float = 0.0
    C_uu: float = 0.0
    at_s: float = -math.inf

    def fade(self, at_s: float, memory_s: float) -> None:
        """Let the sums fade to a time."""
        if at_s <= self.at_s:
            return
        f = math.exp(-(at_s - self.at_s) / memory_s)
        self.c_e *= f
        self.c_n *= f
        g = f * f
        self.C_ee *= g
        self.C_en *= g
        self.C_nn *= g
        self.c_u *= f
        self.C_uu *= g
        self.at_s = at_s

    def add(self, we: float, wn: float, wu: float, whitened: float) -> None:
        """Take the correction (we, wn, wu) * whitened made to the velocity by one innovation of unit variance."""
        self.c_e += we * whitened
        self.c_n += wn * whitened
        self.c_u += wu * whitened
        self.C_ee += we * we
        self.C_en += we * wn
        self.C_nn += wn * wn
        self.C_uu += wu * wu

    def vertical_ratio(self) -> float:
        """Return c^2 / C of the vertical corrections, 1 on average in steady flight and while there is nothing to judge by."""
        return self.c_u * self.c_u / self.C_uu if self.C_uu > 1e-150 else 1.0

    def ratio(self) -> float:
        """Return c' C^-1 c / 2 of the horizontal corrections, 1 on average in steady flight and with nothing to judge by."""
        det = self.C_ee * self.C_nn - self.C_en * self.C_en
        if det <= 1e-9 * self.C_ee * self.C_nn or det < 1e-300:
            trace = self.C_ee + self.C_nn
            return (self.c_e * self.c_e + self.c_n * self.c_n) / trace if trace > 1e-150 else 1.0
        c_e, c_n = self.c_e, self.c_n
        return 0.5 * (self.C_nn * c_e * c_e - 2.0 * self.C_en * c_e * c_n + self.C_ee * c_n * c_n) / det


@dataclass(slots=True)
class Neighbour:
    """What the last range between a subject and one neighbour was: its time and the unit vector from the neighbour."""

    at_s: float
    unit: tuple[float, float, float]


@dataclass(slots=True)
class VehicleRecord:
    """One vehicle. `recent` and `ranges` are bounded tuples, oldest first, replaced and never changed in place.

    `slow_report_h_m`, `slow_report_v_m`, `slow_baro_m`, `stamp_s` are the sigmas in force of the slow errors in the joint state.
    `refused_share` is the fading share of this subject's ranges that the gate refused, `refused_m2` their mean square innovation.
    """

    subject: bool = False
    fixed: bool = False
    last_position: PositionMeasurement | None = None
    recent: tuple[Measurement, ...] = ()
    ranges: tuple[RangeMeasurement, ...] = ()
    white_h: Whiteness = field(default_factory=Whiteness)
    white_v: Whiteness = field(default_factory=Whiteness)
    white_baro: Whiteness = field(default_factory=Whiteness)
    attitude: AttitudeMeasurement | None = None
    slow_report_h_m: float = 0.0
    slow_report_v_m: float = 0.0
    slow_baro_m: float = 0.0
    stamp_s: float = 0.0
    manoeuvre: ManoeuvreMonitor = field(default_factory=ManoeuvreMonitor)
    neighbours: dict[int, Neighbour] = field(default_factory=dict)
    heard: dict[int, float] = field(default_factory=dict)
    chosen: frozenset[int] = frozenset()
    chosen_at_s: float = -math.inf
    informed_at_s: float = -math.inf
    position_used_at_s: float = -math.inf
    velocity_used_at_s: float = -math.inf
    refused_share: float = 0.0
    refused_m2: float = 0.0
    reports_refused: int = 0
    start_tried_at_s: float = -math.inf
    reason: str = "no measurement of it was heard"

    def copy(self) -> VehicleRecord:
        """Return an independent copy."""
        other = _same_fields(self)
        other.white_h = self.white_h.copy()
        other.white_v = self.white_v.copy()
        other.white_baro = self.white_baro.copy()
        other.manoeuvre = _same_fields(self.manoeuvre)
        other.neighbours = dict(self.neighbours)
        other.heard = dict(self.heard)
        return other

    def remember(self, measurement: Measurement) -> None:
        """Keep a measurement of this vehicle's own for a few seconds: a filter for it is started from these when needed."""
        oldest_s = measurement.measured_at_s - _RECENT_S
        recent = self.recent
        if len(recent) >= _RECENT_MOST or (recent and recent[0].measured_at_s < oldest_s):
            recent = tuple(m for m in recent[1 - _RECENT_MOST :] if m.measured_at_s >= oldest_s)
        self.recent = (*recent, measurement)

    def remember_range(self, measurement: RangeMeasurement) -> None:
        """Keep a range for a few seconds: a subject without a position is started from these."""
        oldest_s = measurement.measured_at_s - _RANGES_S
        ranges = self.ranges
        if len(ranges) >= _RANGES_MOST or (ranges and ranges[0].measured_at_s < oldest_s):
            ranges = tuple(m for m in ranges[1 - _RANGES_MOST :] if m.measured_at_s >= oldest_s)
        self.ranges = (*ranges, measurement)
