"""What the fleet filter remembers of one vehicle beside its states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import NamedTuple, TypeVar

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, NoiseSplit

IN_USE_S = 2.0
"""A neighbour whose range was used within so long is in use."""

_RECENT_S = 3.0
_RECENT_MOST = 64
_RANGES_S = 4.0
_RANGES_MOST = 120

OwnMeasurement = PositionMeasurement | AltitudeMeasurement | AttitudeMeasurement
"""What a vehicle measures of itself."""


@dataclass(slots=True)
class ManoeuvreDetector:
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

    def update(
        self, at_s: float, memory_s: float, we: Sequence[float], wn: Sequence[float], wu: Sequence[float], e: Sequence[float]
    ) -> None:
        """Fade to a time, and take the corrections (we, wn, wu) e made to the velocity by innovations e of unit variance."""
        f = math.exp(-(at_s - self.at_s) / memory_s) if at_s > self.at_s else 1.0
        g = f * f
        c_e, c_n, c_u = self.c_e * f, self.c_n * f, self.c_u * f
        C_ee, C_en, C_nn, C_uu = self.C_ee * g, self.C_en * g, self.C_nn * g, self.C_uu * g
        for east, north, up, innovation in zip(we, wn, wu, e, strict=True):
            c_e += east * innovation
            c_n += north * innovation
            c_u += up * innovation
            C_ee += east * east
            C_en += east * north
            C_nn += north * north
            C_uu += up * up
        self.c_e, self.c_n, self.c_u = c_e, c_n, c_u
        self.C_ee, self.C_en, self.C_nn, self.C_uu = C_ee, C_en, C_nn, C_uu
        self.at_s = max(at_s, self.at_s)

    def gains(self) -> tuple[float, float]:
        """Return by how much the accelerations, horizontally and vertically, exceed those of steady flight: 1 where they do not.

        The squares of c' C^-1 c / 2 and of c^2 / C, which are 1 on average in steady flight and with nothing to judge by.
        """
        c_e, c_n, C_ee, C_en, C_nn = self.c_e, self.c_n, self.C_ee, self.C_en, self.C_nn
        det = C_ee * C_nn - C_en * C_en
        if det > 1e-9 * C_ee * C_nn and det >= 1e-300:
            ratio = 0.5 * (C_nn * c_e * c_e - 2.0 * C_en * c_e * c_n + C_ee * c_n * c_n) / det
        else:
            trace = C_ee + C_nn
            ratio = (c_e * c_e + c_n * c_n) / trace if trace > 1e-150 else 1.0
        ratio_v = self.c_u * self.c_u / self.C_uu if self.C_uu > 1e-150 else 1.0
        return max(ratio * ratio, 1.0), max(ratio_v * ratio_v / 3.0, 1.0)


class UnresolvedOutlier(NamedTuple):
    """A range that the gate refused: the neighbour, a unit vector along it, and its NIS."""

    neighbour: int
    unit: tuple[float, float, float]
    nis: float


class ReflectionEvidence(NamedTuple):
    """How many ranges in a row were refused and fit the mirror image, and the neighbour of the last one."""

    neighbour: int
    ranges: int


@dataclass(slots=True)
class Neighbour:
    """What the last range between a denied vehicle and one neighbour was: its time and a unit vector along it."""

    at_s: float
    unit: tuple[float, float, float]


@dataclass(slots=True)
class VehicleRecord:
    """What the filter keeps of one vehicle beside its states.

    `own_measurements` and `range_measurements` are the recent ones, oldest first.
    `report_noise` and `altitude_noise` are the coloured/white splits of its position reports and barometric heights.
    The four `..._sigma_...` are the sigmas in force of its slow errors in the joint state.
    `cusum` is the CUSUM statistic of refused against used ranges: evidence that the state is wrong.
    `unresolved_outlier` is the last refused range that the ranges in use could not have contradicted.
    `reflection_evidence` counts refused ranges that fit the reflected state. `refused_innovation_m2` is the mean squared
    innovation of refused ranges, `range_noise_inflation_m2` the variance added to ranges after a re-inflation.
    """

    denied_vehicle: bool = False
    static: bool = False
    last_position: PositionMeasurement | None = None
    own_measurements: tuple[OwnMeasurement, ...] = ()
    range_measurements: tuple[RangeMeasurement, ...] = ()
    report_noise: NoiseSplit = NO_SAMPLES
    altitude_noise: NoiseSplit = NO_SAMPLES
    attitude: AttitudeMeasurement | None = None
    report_error_sigma_h_m: float = 0.0
    report_error_sigma_v_m: float = 0.0
    baro_error_sigma_m: float = 0.0
    time_stamp_offset_sigma_s: float = 0.0
    manoeuvre: ManoeuvreDetector = field(default_factory=ManoeuvreDetector)
    neighbours: dict[int, Neighbour] = field(default_factory=dict)
    last_range_s: dict[int, float] = field(default_factory=dict)
    selected_peers: frozenset[int] = frozenset()
    selected_at_s: float = -math.inf
    updated_at_s: float = -math.inf
    velocity_used_at_s: float = -math.inf
    cusum: float = 0.0
    unresolved_outlier: UnresolvedOutlier | None = None
    reflection_evidence: ReflectionEvidence | None = None
    refused_innovation_m2: float = 0.0
    range_noise_inflation_m2: float = 0.0
    reports_refused: int = 0
    initialisation_tried_at_s: float = -math.inf
    no_estimate_reason: str = "no measurement of it was heard"

    def copy(self) -> VehicleRecord:
        """Return an independent copy."""
        other = VehicleRecord(*_RECORDED(self))
        other.manoeuvre = ManoeuvreDetector(*_MONITORED(self.manoeuvre))
        other.neighbours = dict(self.neighbours)
        other.last_range_s = dict(self.last_range_s)
        return other

    def add_own(self, measurement: OwnMeasurement) -> None:
        """Keep a measurement of this vehicle's own for a few seconds: a filter for it is started from these when needed."""
        kept = self.own_measurements if len(self.own_measurements) < 2 * _RECENT_MOST else self.own_measurements[-_RECENT_MOST:]
        self.own_measurements = (*kept, measurement)

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Keep a range for a few seconds: a denied vehicle without a position is started from these."""
        kept = (
            self.range_measurements
            if len(self.range_measurements) < 2 * _RANGES_MOST
            else self.range_measurements[-_RANGES_MOST:]
        )
        self.range_measurements = (*kept, measurement)

    @property
    def recent_own(self) -> tuple[OwnMeasurement, ...]:
        """The own measurements of the last 3 s before the newest, 64 at most, oldest first."""
        return _since(self.own_measurements[-_RECENT_MOST:], _RECENT_S)

    @property
    def recent_ranges(self) -> tuple[RangeMeasurement, ...]:
        """The ranges of the last 4 s before the newest, 120 at most, oldest first."""
        return _since(self.range_measurements[-_RANGES_MOST:], _RANGES_S)


_Measured = TypeVar("_Measured", OwnMeasurement, RangeMeasurement)


def _since(measured: tuple[_Measured, ...], span_s: float) -> tuple[_Measured, ...]:
    return tuple(m for m in measured if m.measured_at_s >= measured[-1].measured_at_s - span_s)


# All fields at once, in their order: a copy is made of every vehicle that is heard, ten times a second.
_RECORDED = attrgetter(*(one.name for one in fields(VehicleRecord)))
_MONITORED = attrgetter(*(one.name for one in fields(ManoeuvreDetector)))


class Records(dict[int, VehicleRecord]):
    """What is remembered of all vehicles, by vehicle. Copies share the records, until one is about to be changed: `writable`."""

    __slots__ = ("_own",)

    def __init__(self, records: Mapping[int, VehicleRecord] | None = None) -> None:
        super().__init__(records or {})
        self._own: set[int] = set()

    def copy(self) -> Records:
        """Return an independent copy."""
        self._own.clear()
        return Records(self)

    def writable(self, vehicle: int) -> VehicleRecord:
        """Return a vehicle's record to be changed: a new one where nothing is remembered, one's own where it is shared."""
        if vehicle in self._own:
            return self[vehicle]
        self._own.add(vehicle)
        record = self.get(vehicle)
        record = self[vehicle] = VehicleRecord() if record is None else record.copy()
        return record

    def copy_from(self, other: Records, vehicle: int) -> None:
        """Take what another one remembers of a vehicle."""
        self[vehicle] = other[vehicle].copy()
        self._own.add(vehicle)
