"""Timed measurements in the fleet's frame: what an estimator is fed with, and what it answers.

Frame: east, north, up in metres about the fleet origin. Time: seconds on the service's clock. `measured_at_s` is when
the quantity held, `arrived_at_s` when the service learned of it (never earlier in a healthy set-up, often 50-500 ms
later, and not in the order of measuring). All sigmas are one standard deviation per axis.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector3 = tuple[float, float, float]
FloatArray = NDArray[np.float64]

_NUMBER = re.compile(r"[0-9.]+")


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
    """A slant range between two vehicles; `from_vehicle` measured it. Direction carries no meaning for the value.

    `clock_of` is the vehicle by whose clock it was stamped, None for the service's. `time_sigma_s` is how far that clock may be
    off, `time_sigma_m` what it means at the speed between the two: `sigma_m` holds that already.
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
    """A vehicle's attitude, and its airspeed where known: valid with and without GPS. Yaw from true north, clockwise."""

    vehicle: int
    measured_at_s: float
    arrived_at_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    airspeed_mps: float | None


@dataclass(frozen=True, slots=True)
class OdometryMeasurement:
    """A vehicle's velocity over ground in its own axes (forward, right, m/s) and its turn rate (rad/s, clockwise from above)."""

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
    """What the error of an estimate does not exceed, but with the integrity risk: horizontally (HPL) and vertically (VPL), m.

    It assumes that the receivers of the vehicles `untested` are right: the ranges cannot test them.
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
    integrity stage; None where an estimator is asked by itself.
    """

    vehicle: int
    at_s: float
    position_enu_m: FloatArray
    velocity_enu_mps: FloatArray
    covariance: FloatArray
    hdop: float | None
    ranges_in_use: int
    protection: ProtectionLevel | None = None


@dataclass(frozen=True, slots=True)
class NoEstimate:
    """The honest answer where there is no estimate fit to be stated, with the reason in words."""

    vehicle: int
    at_s: float
    reason: str


def count_reasons(reasons: Iterable[str]) -> dict[str, int]:
    """Return how often each reason of no estimate was given; those that differ in their numbers alone are one.

    Plug-in estimators word their own reasons, so there is no closed list. The first of several stands for all; the
    most frequent comes first.
    """
    first: dict[str, str] = {}
    times = Counter(first.setdefault(_NUMBER.sub("", reason), reason) for reason in reasons)
    return dict(times.most_common())


@dataclass(frozen=True, slots=True)
class Residual:
    """What an estimator made of one range (or one fix, `to_vehicle` None): innovation, its sigma, and the verdict.

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
