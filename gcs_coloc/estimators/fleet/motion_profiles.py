"""Motion profiles: what vehicles of each class do at most, and whether their manoeuvres recur."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.estimators.fleet.settings import BY_REPORT, FleetSettings


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """The most that a vehicle does, and its process noise.

    The most are the largest horizontal speed, horizontal acceleration and climb rate. `noise_levels`: bounds of the learned
    factor of the white acceleration without a fresh bank angle, eq. (30). A plane flies steadily between turns, which the
    manoeuvre detector finds. The manoeuvres of other vehicles recur (`is_recurring`). A vehicle of which nothing is known has the
    white acceleration of the settings. `climb_level`: factor of the vertical one where reports or a barometric height show the
    climbs.
    """

    max_speed_mps: float
    max_acceleration_mps2: float
    max_climb_mps: float
    noise_levels: tuple[float, float]
    is_recurring: bool
    climb_level: float = 1.0

    def reach_m(self, since_s: float, acceleration_mps2: float) -> float:
        """Return how far an acceleration may take a vehicle from where its velocity leads, m.

        It is min(a t^2 / 2, 2 V t).
        """
        return min(0.5 * acceleration_mps2 * since_s * since_s, 2.0 * self.max_speed_mps * since_s)


_AS_SET = (1.0, 1.0), False
_TURNING = (1.0, 30.0), False
"""Chosen: to 9 m^2/s^3, turns of 30 degrees of bank between steady legs."""
_RECURRING = (0.03, 300.0), True
"""Chosen: from 0.03 m^2/s^3, at rest, to 300 m^2/s^3, 1 g in turns of a second to either side."""
_CLIMB_LEVEL_OF_A_MULTIROTOR = 15.0
"""To 0.3 m^2/s^3. Chosen: climbs of 8 m/s are followed to 4 m; a barometer that creeps away as fast as a climb leads astray."""
PROFILES: Mapping[VehicleClass | None, MotionProfile] = {
    None: MotionProfile(30.0, 9.8, 5.0, *_AS_SET),
    VehicleClass.PLANE: MotionProfile(50.0, 9.8, 5.0, *_TURNING),
    VehicleClass.MULTIROTOR: MotionProfile(20.0, 9.8, 5.0, *_RECURRING, _CLIMB_LEVEL_OF_A_MULTIROTOR),
    VehicleClass.GROUND: MotionProfile(10.0, 4.0, 2.0, *_RECURRING),
    VehicleClass.BOAT: MotionProfile(15.0, 3.0, 0.5, *_RECURRING),
    VehicleClass.INDOOR: MotionProfile(3.0, 4.0, 2.0, *_RECURRING),
}
"""By class; None: it is not known. Chosen: accelerations of a level turn at 45 degrees of bank, of tyres on gravel, of a rudder,
and of a robot's motors; speeds that small vehicles of these classes seldom exceed."""


def motion_profile(reported: VehicleClass | None, s: FleetSettings) -> MotionProfile:
    """Return the profile of a vehicle by its reported class and the settings, which prevail."""
    profile = PROFILES[reported if s.vehicle_class == BY_REPORT else VehicleClass(s.vehicle_class)]
    if s.max_speed_mps is not None:
        profile = replace(profile, max_speed_mps=s.max_speed_mps, max_climb_mps=min(profile.max_climb_mps, s.max_speed_mps))
    if s.max_acceleration_mps2 is not None:
        profile = replace(profile, max_acceleration_mps2=s.max_acceleration_mps2)
    return profile
