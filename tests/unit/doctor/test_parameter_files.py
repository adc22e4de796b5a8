"""Parameter files: what they hold sets the vehicle right, in the formats of the ground stations."""

from __future__ import annotations

import csv
from dataclasses import replace

import pytest
from pymavlink import mavparm

from gcs_coloc.core.errors import UsageError
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.doctor.finding import Setup, VehicleSurvey
from gcs_coloc.doctor.parameter_files import parameters_to_set, write_parameter_files
from gcs_coloc.doctor.report import of_vehicle
from tests.unit.doctor.test_checks import FLEET, GOOD

WRONG = {"GPS2_TYPE": 0.0, "GPS_PRIMARY": 1.0, "GPS_AUTO_SWITCH": 1.0, "EK3_SRC1_VELZ": 3.0}
RIGHT = {"GPS2_TYPE": 14.0, "GPS_PRIMARY": 0.0, "GPS_AUTO_SWITCH": 4.0, "EK3_SRC1_VELZ": 0.0}
INT8, REAL32 = 2, 9
ARDUPILOT = replace(
    GOOD, parameters=GOOD.parameters | WRONG, parameter_kinds=dict.fromkeys(("GPS2_TYPE", "GPS_PRIMARY", "EK3_SRC1_VELZ"), INT8)
)
PX4 = VehicleSurvey(
    sysid=7,
    autopilot=Autopilot.PX4,
    parameters={"EKF2_EV_CTRL": 2.0, "EKF2_EV_NOISE_MD": 1.0, "EKF2_EV_DELAY": 175.0},
    parameter_kinds={"EKF2_EV_CTRL": 6, "EKF2_EV_NOISE_MD": 6, "EKF2_EV_DELAY": REAL32},
)


def written(tmp_path, *vehicles):
    return [path.name for path in write_parameter_files(tmp_path / "new" / "params", vehicles, Setup())]


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.reader((line for line in file if not line.startswith("#")), delimiter="\t"))


def test_an_ardupilot_gets_one_file_for_mission_planner_and_mavproxy_and_one_for_qgroundcontrol(tmp_path):
    assert written(tmp_path, ARDUPILOT) == ["vehicle-4.param", "vehicle-4.params"]
    for_mavproxy = mavparm.MAVParmDict()
    assert for_mavproxy.load(str(tmp_path / "new/params/vehicle-4.param"))
    assert dict(for_mavproxy) == RIGHT
    lines = (tmp_path / "new/params/vehicle-4.param").read_text().splitlines()
    assert [line for line in lines if not line.startswith("#")] == [f"{name},{value:g}" for name, value in for_mavproxy.items()]
    rows = rows_of(tmp_path / "new/params/vehicle-4.params")
    assert {name: (sysid, compid, float(value), int(kind)) for sysid, compid, name, value, kind in rows} == {
        name: ("4", "1", value, INT8 if name in ARDUPILOT.parameter_kinds else REAL32) for name, value in RIGHT.items()
    }


def test_a_px4_gets_qgroundcontrols_file_alone(tmp_path):
    assert written(tmp_path, PX4) == ["vehicle-7.params"]
    rows = rows_of(tmp_path / "new/params/vehicle-7.params")
    assert sorted(rows) == [
        ["7", "1", "EKF2_EV_CTRL", "1", "6"],  # one bit is to be set and another to be cleared
        ["7", "1", "EKF2_EV_DELAY", "0", "9"],
        ["7", "1", "EKF2_EV_NOISE_MD", "0", "6"],
    ]


@pytest.mark.parametrize("vehicle", [ARDUPILOT, PX4])
def test_with_what_is_in_the_file_the_doctor_has_nothing_more_to_set(vehicle):
    changes = parameters_to_set(vehicle, Setup(), FLEET)
    corrected = replace(vehicle, parameters=vehicle.parameters | {name: value for name, (value, _) in changes.items()})
    assert changes
    assert [one for one in of_vehicle(corrected, Setup(), FLEET) if one.parameter is not None] == []


def test_each_value_has_its_reason_beside_it(tmp_path):
    written(tmp_path, ARDUPILOT)
    text = (tmp_path / "new/params/vehicle-4.param").read_text()
    assert "# GPS2_TYPE = 0: it does not take GPS_INPUT as that receiver\nGPS2_TYPE,14\n" in text


def test_a_vehicle_that_is_right_gets_no_file(tmp_path):
    assert written(tmp_path, GOOD) == []


def test_a_directory_that_cannot_be_made_is_told_in_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"--write-params .*cannot be written to: "):
        list(write_parameter_files(tmp_path / "file", (ARDUPILOT,), Setup()))
