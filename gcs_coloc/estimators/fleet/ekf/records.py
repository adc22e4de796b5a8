"""Records: what the filter keeps of each vehicle beside its states.

Copies share a record until one of them changes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import NamedTuple, TypeVar

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    NoEstimateReason,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
)
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, ManoeuvreDetector, NoiseLevel, NoiseSplit
from gcs_coloc.estimators.fleet.ekf.air_data import AIR_UNSUSPECTED, AirCalibration, AirCheck
from gcs_coloc.estimators.fleet.ekf.possible_motion import PROFILES, MotionProfile, UnshownMotion
from gcs_coloc.estimators.fleet.ekf.state import PairKey
from gcs_coloc.estimators.fleet.ekf.tilt import Tilt
from gcs_coloc.estimators.fleet.range_biases import BiasWindow, PairBias, RangeBiases, Ranged, UnknownBias
from gcs_coloc.estimators.fleet.search.position_search import PositionSearch

IN_USE_S = 2.0
"""Chosen: a neighbour whose range was used within so long is in use; two ranges may be lost at 1 Hz."""
_IN_USE_INTERVALS = 3.0  # chosen: where ranges come more seldom, as many may be lost
_IN_USE_MOST_S = 6.0  # chosen: over a longer time a range tells too little of where the vehicle is now
_INTERVAL_SHARE = 0.2  # chosen: of the latest interval in their mean; one gap alone makes ranges no rarer
_SUSPECTED_FROM = 2  # refused ranges in a row; chosen: a single one is multipath, and tells nothing of the next
_RECENT_S = 3.0
_RECENT_MOST = 64
"""Chosen: own measurements from which an initialisation replays, enough for velocity; bounded in memory."""
RANGES_S = 4.0
_RANGES_MOST = 120
"""Chosen: ranges for multilateration, of so short a time that few turns are in it; bounded in memory."""

OwnMeasurement = PositionMeasurement | AltitudeMeasurement | AttitudeMeasurement | OdometryMeasurement
"""What a vehicle measures of itself."""


class LeftOut(NamedTuple):
    """The peers that were left out of every start from ranges since a time: their devices seem faulty."""

    peers: frozenset[int]
    since_s: float


class UnresolvedOutlier(NamedTuple):
    """A refused range, along `unit`, that the ranges in use could not contradict."""

    neighbour: int
    unit: tuple[float, float, float]
    innovation_m: float
    nis: float


class SuspectedDevice(NamedTuple):
    """A neighbour whose last ranges were refused and resolved.

    Others in use would have shown it if they were right. `refused` counts them in a row; `variance_m2` is the square of the gate
    at the last one, less with each range that fits again.
    """

    refused: int
    variance_m2: float


class ReflectionEvidence(NamedTuple):
    """Refused ranges in a row that fit the reflected position of a denied vehicle.

    `ranges` is their number. `neighbour` is the other end of the last one. `peers` are the two in use beside it, in whose plane
    the vehicle is reflected.
    """

    neighbour: int
    peers: frozenset[int]
    ranges: int


@dataclass(slots=True)
class Neighbour:
    """The last used range between a denied vehicle and one neighbour.

    Its time, a unit vector along it, the key of the pair, the sigma of its innovation, m, and the mean interval of such ranges.
    """

    at_s: float
    unit: tuple[float, float, float]
    pair: PairKey
    sigma_m: float
    interval_s: float = 0.0

    @property
    def in_use_s(self) -> float:
        """How long after its last range a neighbour is in use, s: until its next one is overdue."""
        return max(IN_USE_S, min(_IN_USE_INTERVALS * self.interval_s, _IN_USE_MOST_S))

    def interval_until_s(self, at_s: float) -> float:
        """Return the mean interval of its ranges with one more at a time."""
        latest_s = min(at_s - self.at_s, _IN_USE_MOST_S)
        return self.interval_s + _INTERVAL_SHARE * (latest_s - self.interval_s)


_NOT_HEARD = Unlocated(NoEstimateReason.NOT_HEARD)


@dataclass(slots=True)
class VehicleRecord:
    """What the filter keeps of one vehicle beside its states."""

    denied_vehicle: bool = False
    static: bool = False
    """Whether it is an anchor that does not move: its state is a position alone."""
    in_one_step: bool = False
    """Whether no propagation is divided for the sake of the linearisation, as of a vehicle whose reports keep to a known way."""
    last_position: PositionMeasurement | None = None
    own_measurements: tuple[OwnMeasurement, ...] = ()
    """Recent measurements of itself, oldest first; a superset of `recent_own`."""
    range_measurements: tuple[RangeMeasurement, ...] = ()
    """Recent ranges of a denied vehicle, oldest first; a superset of `recent_ranges`."""
    report_noise: NoiseSplit = NO_SAMPLES
    """Coloured/white split of its position reports, groups horizontal and vertical."""
    altitude_noise: NoiseSplit = NO_SAMPLES
    """Coloured/white split of its barometric heights."""
    attitude: AttitudeMeasurement | None = None
    """The newest attitude with an airspeed; it has none where that is refused."""
    tilt: Tilt | None = None
    """The newest tilt of a multirotor."""
    air_check: AirCheck = AIR_UNSUSPECTED
    """Whether its air data contradict its way over ground."""
    odometry: OdometryMeasurement | None = None
    """The newest odometry that was used."""
    report_error_sigma_h_m: float = 0.0
    """Steady-state sigma in force of the error of its position reports, horizontal."""
    report_error_sigma_v_m: float = 0.0
    """The same, vertical."""
    baro_error_sigma_m: float = 0.0
    """Steady-state sigma in force of the error of its barometric height; 0 while no height is used."""
    time_stamp_offset_sigma_s: float = 0.0
    """Steady-state sigma in force of its time-stamp offset."""
    manoeuvre: ManoeuvreDetector = field(default_factory=ManoeuvreDetector)
    gust_noise: NoiseLevel = field(default_factory=NoiseLevel)
    """The level of gusts, learned and used while its attitude is fresh."""
    manoeuvre_noise: NoiseLevel = field(default_factory=NoiseLevel)
    """The level of its manoeuvres, learned and used while its attitude is not fresh, and from its reports before."""
    air_calibrations: tuple[AirCalibration, ...] = ()
    """The last two with its own GPS: an initialisation needs one from before the reports that it replays."""
    profile: MotionProfile = PROFILES[None]
    neighbours: dict[int, Neighbour] = field(default_factory=dict)
    """The neighbours whose ranges were used, by vehicle."""
    last_range_s: dict[int, float] = field(default_factory=dict)
    """Time of the last range with each neighbour, used or not."""
    selected_peers: frozenset[int] = frozenset()
    selected_at_s: float = -math.inf
    updated_at_s: float = -math.inf
    """Time of the last position report or range that was used."""
    gaps_added_until_s: float = -math.inf
    """Until then GPS or ranges told of its motion along both horizontal axes, or its covariance holds what it may have done."""
    told_at_s: float = -math.inf
    """Until then GPS, the ranges of several neighbours or its own motion sensors told of its motion along all directions."""
    unshown: UnshownMotion | None = None
    """What it may have done in its last gap beyond what it has shown before."""
    report_used_at_s: float = -math.inf
    """Time of the last position report that was used."""
    velocity_used_at_s: float = -math.inf
    """Time of the last position report whose velocity was used."""
    began_on_either_side: bool = False
    """Whether its first ranges left its height so open that it may have begun above or below its peers, and nothing has since."""
    height_at_s: float = -math.inf
    """Time of the last barometric height."""
    height_innovation_m: float = 0.0
    """Its innovation."""
    height_used_at_s: float = math.inf
    """Time of the last barometric height within the gate; infinite before the first and after a pause: no climb explains it."""
    height_jumps_m: float = 0.0
    """By how much its barometric height has jumped since it was lost, eq. (43); heights are used less that."""
    cusum: float = 0.0
    """CUSUM statistic of refused against used ranges, eq. (21): evidence that the state is wrong."""
    unresolved_outlier: UnresolvedOutlier | None = None
    reflection_evidence: ReflectionEvidence | None = None
    refused_innovation_m2: float = 0.0
    """Mean squared innovation of the refused ranges, m^2."""
    range_noise_inflation_m2: float = 0.0
    """Variance added to ranges since the covariance was inflated, m^2."""
    suspected: dict[int, SuspectedDevice] = field(default_factory=dict)
    """The neighbours whose ranges are suspected, by vehicle."""
    reports_refused: int = 0
    """Position reports refused by the gate in a row."""
    search: PositionSearch | None = None
    """The search for a denied vehicle that is in no cluster because it is too uncertain for one."""
    range_biases: RangeBiases = field(default_factory=RangeBiases)
    """What its ranges have shown of their lasting errors."""
    unknown_bias: UnknownBias | None = None
    """Biases that its ranges may have unfound; None while its ranges are so coarse that none would tell."""
    presumed_bias: UnknownBias | None = None
    """The same before any range has told of it."""
    bias_window: BiasWindow | None = None
    """The ranges since the last that were counted in `range_biases`."""
    initialisation_tried_at_s: float = -math.inf
    left_out: LeftOut | None = None
    """The faulty devices that the last try left out, if it found the vehicle without them."""
    no_estimate_reason: Unlocated = _NOT_HEARD

    @property
    def has_height(self) -> bool:
        """Whether a height of its own is in its states."""
        return self.baro_error_sigma_m > 0.0

    def lasting_error(self, pair: Ranged) -> PairBias | None:
        """Return what is known of a pair's lasting error; None where ranges are too coarse to tell of it."""
        known, unknown = self.range_biases.bias(pair), self.unknown_bias
        return known if known is not None or unknown is None else PairBias(0.0, math.hypot(unknown.device_m, unknown.pair_m))

    def copy(self) -> VehicleRecord:
        """Return an independent copy."""
        other = VehicleRecord(*_RECORD_FIELDS(self))
        other.manoeuvre = self.manoeuvre.copy()
        other.gust_noise = self.gust_noise.copy()
        other.manoeuvre_noise = self.manoeuvre_noise.copy()
        other.neighbours = dict(self.neighbours)
        other.last_range_s = dict(self.last_range_s)
        other.suspected = dict(self.suspected)
        return other

    def forget_tests(self) -> None:
        """Forget what tests of ranges have shown of the states so far: others begin."""
        self.cusum = self.range_noise_inflation_m2 = 0.0
        self.unresolved_outlier = self.reflection_evidence = self.bias_window = None
        self.suspected = {}

    def suspicion_m2(self, neighbour: int) -> float:
        """Return the variance to add to a range of a neighbour that is suspected, else 0, m^2."""
        suspected = self.suspected.get(neighbour)
        return suspected.variance_m2 if suspected is not None and suspected.refused >= _SUSPECTED_FROM else 0.0

    def in_use_s(self, neighbour: int) -> float:
        """Return how long after its last range a neighbour is in use."""
        known = self.neighbours.get(neighbour)
        return IN_USE_S if known is None else known.in_use_s

    def add_own(self, measurement: OwnMeasurement) -> None:
        """Keep a measurement of this vehicle's own, from which its state can be initialised."""
        kept = self.own_measurements
        self.own_measurements = (*(kept if len(kept) < 2 * _RECENT_MOST else kept[-_RECENT_MOST:]), measurement)

    def add_range(self, measurement: RangeMeasurement) -> None:
        """Keep a range, from which a denied vehicle without a position can be initialised."""
        kept = self.range_measurements
        self.range_measurements = (*(kept if len(kept) < 2 * _RANGES_MOST else kept[-_RANGES_MOST:]), measurement)

    @property
    def recent_own(self) -> tuple[OwnMeasurement, ...]:
        """The own measurements of the last 3 s before the newest, 64 at most, oldest first."""
        return _since(self.own_measurements[-_RECENT_MOST:], _RECENT_S)

    @property
    def recent_ranges(self) -> tuple[RangeMeasurement, ...]:
        """The ranges of the last 4 s before the newest, 120 at most, oldest first."""
        return _since(self.range_measurements[-_RANGES_MOST:], RANGES_S)


_Measured = TypeVar("_Measured", OwnMeasurement, RangeMeasurement)


def _since(measured: tuple[_Measured, ...], span_s: float) -> tuple[_Measured, ...]:
    return tuple(m for m in measured if m.measured_at_s >= measured[-1].measured_at_s - span_s)


# All fields at once: a record is copied for every active vehicle, ten times a second.
_RECORD_FIELDS = attrgetter(*(one.name for one in fields(VehicleRecord)))


class Records(dict[int, VehicleRecord]):
    """The records of all vehicles, by vehicle.

    Copies share each record until one side changes it (copy on write). `unreported` is the profile of a vehicle whose class
    nobody has reported.
    """

    __slots__ = ("_own", "_unreported")

    def __init__(self, records: Mapping[int, VehicleRecord] | None = None, unreported: MotionProfile = PROFILES[None]) -> None:
        super().__init__(records or {})
        self._unreported = unreported
        self._own: set[int] = set()

    def copy(self) -> Records:
        """Return an independent copy."""
        self._own.clear()
        return Records(self, self._unreported)

    def writable(self, vehicle: int) -> VehicleRecord:
        """Return a vehicle's record for changing: a new one if there is none, a copy if it is shared."""
        if vehicle in self._own:
            return self[vehicle]
        self._own.add(vehicle)
        record = self.get(vehicle)
        record = self[vehicle] = VehicleRecord(profile=self._unreported) if record is None else record.copy()
        return record

    def copy_from(self, other: Records, vehicle: int) -> None:
        """Copy the record of a vehicle from another set of records."""
        self[vehicle] = other[vehicle].copy()
        self._own.add(vehicle)
