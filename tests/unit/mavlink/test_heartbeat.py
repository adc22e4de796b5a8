"""Flight modes have the names that ground stations show, and a vehicle's class is by its type."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.mavlink.heartbeat import ardupilot_mode, heartbeat, px4_mode


@pytest.mark.parametrize(
    ("vehicle_type", "custom_mode", "name"),
    [
        (mavlink.MAV_TYPE_FIXED_WING, 10, "AUTO"),
        (mavlink.MAV_TYPE_VTOL_TILTROTOR, 18, "QHOVER"),
        (mavlink.MAV_TYPE_QUADROTOR, 6, "RTL"),
        (mavlink.MAV_TYPE_GROUND_ROVER, 4, "HOLD"),
        (mavlink.MAV_TYPE_SURFACE_BOAT, 10, "AUTO"),
        (mavlink.MAV_TYPE_SUBMARINE, 19, "MANUAL"),
        (mavlink.MAV_TYPE_QUADROTOR, 99, "99"),
    ],
)
def test_a_mode_of_ardupilot_depends_on_the_type_of_vehicle(vehicle_type, custom_mode, name):
    assert ardupilot_mode(vehicle_type, custom_mode) == name


@pytest.mark.parametrize(
    ("custom_mode", "name"),
    [(3 << 16, "POSCTL"), (4 << 16 | 5 << 24, "RTL"), (4 << 16 | 4 << 24, "MISSION"), (0, "0"), (99 << 16, "6488064")],
)
def test_a_mode_of_px4_is_its_main_mode_or_what_auto_does(custom_mode, name):
    assert px4_mode(custom_mode) == name


@pytest.mark.parametrize("vehicle_type", [mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_DECAROTOR, 43])
def test_multirotors_of_any_number_of_rotors_are_of_that_class(vehicle_type):
    """43 is GENERIC_MULTIROTOR, which older pymavlinks do not name."""
    found = heartbeat(1, 0.0, (0, vehicle_type, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 4, 3))
    assert found is not None
    assert found.vehicle_class is VehicleClass.MULTIROTOR
