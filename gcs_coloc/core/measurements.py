"""Timed measurements in the fleet's frame: what an estimator is fed with, and what it answers.

Frame: east, north, up in metres about the fleet origin. Time: seconds on the service's clock. `measured_at_s` is when
the quantity held, `arrived_at_s` when the service learned of it (never earlier in a healthy set-up, often 50-500 ms
later, and not in the order of measuring). All sigmas are one standard deviation per axis.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gcs_coloc.core.reasons import StatedReason, WordedReason

Vector3 = tuple[float, float, float]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PositionMeasurement:
    """A vehicle's position, and its velocity where known, from a receiver that is trusted at that time.

    Never made from what a vehicle without GPS says of its own position. `static`: a fixed anchor; one report is enough.

    `time_sigma_s` is how far `measured_at_s` may be off, an error that lasts as long as the clocks do. What it means in metres,
    speed times it, is in `sigma_h_m` and `sigma_v_m` already: an estimator need not know of clocks.
    """

    vehicle: int
    measured_at_s: float
    arrived_at_s: float
    position_enu_m: Vector3
    sigma_h_m: float
    sigma_v_m: float
    velocity_enu_mps: Vector3 | None = None
    sigma_velocity_mps: float | None = None
    static: bool = False
    time_sigma_s: float = 0.0


@dataclass(frozen=True, slots=True)
class RangeMeasurement:
    """A slant range between two vehicles, measured by `from_vehicle`.

    Direction carries no meaning for the value.

    `clock_of` is the vehicle by whose clock it was stamped, None for the service's. `time_sigma_s` is how far that clock may be
    off, `time_sigma_m` what it means at the speed between the two: `sigma_m` holds that already. `samples`: how many ranges it
    is the mean of, in `sigma_m` already.

    `offset_enu_m`: lever arm of `to_vehicle`'s antenna minus that of `from_vehicle`'s. With x from the reference point of
    `from_vehicle` to that of `to_vehicle` the range is |x + offset|. Zero between reference points, as all ranges of the service.
    """

    from_vehicle: int
    to_vehicle: int
    measured_at_s: float
    arrived_at_s: float
    range_m: float
    sigma_m: float
    device_id: int = 0
    clock_of: int | None = None
    time_sigma_s: float = 0.0
    time_sigma_m: float = 0.0
    samples: float = 1.0
    offset_enu_m: Vector3 = (0.0, 0.0, 0.0)

    @property
    def ends(self) -> tuple[int, int]:
        """Both vehicles."""
        return self.from_vehicle, self.to_vehicle

    def other_end(self, vehicle: int) -> int:
        """Return the end that a vehicle at the one end ranges."""
        return self.to_vehicle if self.from_vehicle == vehicle else self.from_vehicle

    def virtual_end(self, vehicle: int, position_enu_m: Vector3) -> Vector3:
        """Return where one end, at a position, seems to be from the reference point of the other end.

        There it takes both lever arms over: the range is the distance to it.
        """
        (e, n, u), (oe, on, ou) = position_enu_m, self.offset_enu_m
        return (e - oe, n - on, u - ou) if vehicle == self.from_vehicle else (e + oe, n + on, u + ou)


@dataclass(frozen=True, slots=True)
class AltitudeMeasurement:
    """A vehicle's height in the fleet frame from its barometer: valid with and without GPS."""

    vehicle: int
    measured_at_s: float
    arrived_at_s: float
    up_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class AttitudeMeasurement:
    """A vehicle's attitude, and its airspeed where known: valid with and without GPS.

    Yaw is from true north, clockwise.
    """

    vehicle: int
    measured_at_s: float
    arrived_at_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    airspeed_mps: float | None


@dataclass(frozen=True, slots=True)
class OdometryMeasurement:
    """A vehicle's velocity over ground in its own axes, and its turn rate.

    Forward and right in m/s; rad/s, clockwise from above.
    """

    vehicle: int
    measured_at_s: float
    arrived_at_s: float
    forward_mps: float
    right_mps: float
    turn_radps: float
    sigma_velocity_mps: float
    sigma_turn_radps: float


class VehicleClass(StrEnum):
    """How a vehicle moves."""

    PLANE = "plane"
    """On wings; VTOLs too."""
    MULTIROTOR = "multirotor"
    """Multirotors and helicopters."""
    GROUND = "ground"
    BOAT = "boat"
    """Surface vessels and submarines."""
    INDOOR = "indoor"
    """Anything that moves within rooms."""


@dataclass(frozen=True, slots=True)
class VehicleClassReport:
    """The class of a vehicle, from `measured_at_s` on; an estimator that has no use for it ignores it."""

    vehicle: int
    measured_at_s: float
    arrived_at_s: float
    vehicle_class: VehicleClass


Measurement = (
    PositionMeasurement | RangeMeasurement | AltitudeMeasurement | AttitudeMeasurement | OdometryMeasurement | VehicleClassReport
)


class ProtectionLevel(NamedTuple):
    """What the error of an estimate does not exceed, but with the integrity risk.

    Horizontally (HPL) and vertically (VPL), m.

    The ranges cannot test the receivers of the vehicles `untested`, nor, where its own id is among them, the vehicle's ranging
    device: no fault of theirs may move the estimate by more than some 20 m.
    """

    horizontal_m: float
    vertical_m: float
    untested: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Estimate:
    """Where one vehicle is at one time.

    `position_enu_m` (3,) m, `velocity_enu_mps` (3,) m/s, `covariance` (6, 6) of position then velocity, symmetric
    positive definite. `hdop` is the horizontal dilution of the ranges in use (no clock column), `None` where there are
    fewer than two. `ranges_in_use` counts the distinct vehicles whose ranges were used lately. `protection` is set by the
    integrity stage; None where an estimator is asked by itself. `far_covariance` (2, 2) m^2 holds horizontally for the protection
    level, five sigmas and more out, where the error is no Gaussian; None: `covariance` does. `refuses_air_data`: its airspeed
    and heading contradict its motion, so that they do not show how it moves. `air_data_at_s`: the newest attitude in it, service
    time in s; -inf: it has none, inf: the estimator does not tell.
    """

    vehicle: int
    at_s: float
    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    covariance: FloatArray
    hdop: float | None
    ranges_in_use: int
    protection: ProtectionLevel | None = None
    far_covariance: FloatArray | None = None
    refuses_air_data: bool = False
    air_data_at_s: float = math.inf

    @property
    def protected_covariance(self) -> FloatArray:
        """The horizontal covariance (2, 2) that holds far out, m^2."""
        return self.covariance[:2, :2] if self.far_covariance is None else self.far_covariance


class NoEstimateReason(WordedReason):
    """Why there is no estimate of a vehicle.

    A plug-in says in `detail` of OTHER what none of the others does.
    """

    NOT_HEARD = "not_heard", "no measurement of it was heard"
    NOT_LOCATED = "not_located", "not located yet{detail}"
    NO_START = "no_start", "no fresh position to start from, and not enough ranges yet"
    NO_REPORT_SINCE_TRUSTED = "no_report_since_trusted", "no position report since its GPS was trusted again"
    SILENT = "silent", "nothing was heard of it for more than an hour, and not enough ranges yet"
    STALE = "stale", "no position report for {value:.0f} s"
    NO_FIX = "no_fix", "no fix from ranges for {value:.1f} s{detail}"
    NO_HEIGHT = "no_height", "no height of its own"
    CONFIRMING = "confirming", "only {value:.0f} of {limit:.0f} fixes that must agree after a start from ranges"
    FEW_RANGES = "few_ranges", "waiting for ranges to start from: {value:.0f} with {limit:.0f} located peers in the last seconds"
    CONTRADICTORY = "contradictory", "the ranges contradict each other: no place fits them"
    UNDETERMINED = "undetermined", "the geometry of the peers does not determine the position: {value:.0f} m (1-sigma)"
    OTHER_PLACE = "other_place", "ambiguous: another place, {value:.0f} m from the first, fits the ranges as well"
    SEVERAL_PLACES = "several_places", "ambiguous: {value:.0f} places fit the ranges"
    TOO_UNCERTAIN = (
        "too_uncertain",
        "too uncertain: {value:.0f} m (1-sigma) horizontally; more or better placed ranges are needed{detail}",
    )
    UNTESTED = "untested", "found from ranges just now, which have not been tested against each other yet"
    FAR_FROM_ORIGIN = (
        "far_from_origin",
        "{value:.0f} km from the origin, where the vehicle heard first said it was; restart the service without that vehicle",
    )
    BEFORE_MEASUREMENTS = "before_measurements", "asked for a time {value:.1f} s before its newest measurement"
    ESTIMATOR_FAILED = "estimator_failed", "the estimator {detail}"
    OTHER = "other", "{detail}"


AMBIGUOUS = frozenset({NoEstimateReason.OTHER_PLACE, NoEstimateReason.SEVERAL_PLACES})
"""The reasons by which more than one place fits the ranges."""
Unlocated = StatedReason[NoEstimateReason]
"""Why there is no estimate, with the numbers of it."""


@dataclass(frozen=True, slots=True)
class NoEstimate:
    """The honest answer where there is no estimate fit to be stated, with the reason."""

    vehicle: int
    at_s: float
    reason: Unlocated


def count_reasons(reasons: Iterable[Unlocated]) -> dict[Unlocated, int]:
    """Return how often each reason was given, with the numbers of its first time, most frequent first."""
    first: dict[NoEstimateReason, Unlocated] = {}
    return dict(Counter(first.setdefault(stated.reason, stated) for stated in reasons).most_common())


def is_possible(measurement: Measurement) -> bool:
    """Return whether a measurement is possible: finite, sigmas above 0, a range not below 0 with two ends."""
    for one in fields(measurement):
        value = getattr(measurement, one.name)
        numbers = value if isinstance(value, tuple) else () if value is None else (value,)
        if not all(math.isfinite(number) for number in numbers):
            return False
    match measurement:
        case PositionMeasurement():
            speed_sigma = measurement.sigma_velocity_mps
            return measurement.sigma_h_m > 0.0 and measurement.sigma_v_m > 0.0 and (speed_sigma is None or speed_sigma > 0.0)
        case RangeMeasurement():
            return measurement.sigma_m > 0.0 and measurement.range_m >= 0.0 and measurement.from_vehicle != measurement.to_vehicle
        case AltitudeMeasurement():
            return measurement.sigma_m > 0.0
        case AttitudeMeasurement() | OdometryMeasurement() | VehicleClassReport():
            return True


@dataclass(frozen=True, slots=True)
class Residual:
    """What an estimator made of one range, or of one fix (`to_vehicle` None).

    The innovation, its sigma, and whether it was used.

    `nis` is the normalised innovation squared with `degrees_of_freedom`. `refused` is the reason in words, `None` where it
    was used.
    """

    from_vehicle: int
    to_vehicle: int | None
    measured_at_s: float
    innovation_m: float
    sigma_m: float
    nis: float
    degrees_of_freedom: int
    refused: str | None
