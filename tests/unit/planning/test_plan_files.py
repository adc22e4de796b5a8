"""Plan files are read as QGroundControl and Mission Planner write them; what is malformed is told in one line."""

import json
import math
from pathlib import Path

import pytest

from gcs_coloc.config.sections import StationConfig
from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.planning.load import load_plan
from gcs_coloc.planning.mission import ListedStation, MissionCommand, PerVehicle
from gcs_coloc.planning.plan_files import read_plan_file

SCENARIOS = Path(__file__).resolve().parents[3] / "sitl_fakes/scenarios"


def item(command, lat=47.0, lon=8.0, alt=100.0, frame=3, params=(0, 0, 0, None)):
    return {"type": "SimpleItem", "command": command, "frame": frame, "autoContinue": True, "params": [*params, lat, lon, alt]}


def qgc(tmp_path, items, **more):
    mission = {"cruiseSpeed": 18, "hoverSpeed": 6, "vehicleType": 1, "plannedHomePosition": [47.0, 8.0, 500.0], "items": items}
    path = tmp_path / "a.plan"
    path.write_text(json.dumps({"fileType": "Plan", "mission": mission | more}))
    return path


def wpl(tmp_path, *rows, header="QGC WPL 110"):
    path = tmp_path / "a.waypoints"
    path.write_text("\r\n".join([header, *rows]))
    return path


HOME = "0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t500\t1"
ROW = "1\t0\t3\t16\t0\t0\t0\t0\t47.01\t8.0\t100\t1"


WRONG_FRAME = ROW.replace("3\t16", "9\t16")


def test_a_plan_of_qgroundcontrol_gives_its_places_speeds_and_stays(tmp_path):
    loiter = item(19, 47.01, 8.01, params=(30, 0, 120, None))
    change, camera = item(178, 0, 0, 0, 2, (0, 12, -1, 0)), item(206, 0, 0, 0, 2)
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": [item(16, 47.03)]}}
    path = qgc(tmp_path, [item(22), item(16, 47.01), change, camera, loiter, survey, item(20, 0, 0, 0), item(16, 48.0)])
    read = read_plan_file(path)
    (mission,) = read.missions
    assert mission.begin == (47.0, 8.0, 500.0)
    assert mission.vehicle_class is VehicleClass.PLANE
    assert [leg.end for leg in mission.legs] == [
        *((47.0, 8.0, 600.0), (47.01, 8.0, 600.0), (47.01, 8.01, 600.0), (47.03, 8.0, 600.0), (47.0, 8.0, 600.0))
    ]
    assert [leg.speed_mps for leg in mission.legs] == [18, 18, 12, 12, 12]
    assert (mission.legs[2].hold_s, mission.legs[2].radius_m) == (30.0, 120.0)
    assert read.remarks == (
        f"{path}: item 4: command 206 is no waypoint and is skipped",
        f"{path}: item 8: after RETURN_TO_LAUNCH of item 7 and not flown",
    )


@pytest.mark.parametrize("last", [17, 20, 21, 85])
def test_what_stands_after_the_end_of_the_way_is_named(tmp_path, last):
    items = [item(16, 47.01), item(last, 47.02), item(16, 47.03), item(206), item(16, 47.04)]
    remarks = read_plan_file(qgc(tmp_path, items)).remarks
    assert remarks[-1].endswith(f"a.plan: items 3 to 5: after {MissionCommand(last).name} of item 2 and not flown")


def test_whatever_is_not_flown_as_it_stands_is_named(tmp_path):
    terrain = [item(16, 47.01, frame=10), item(16, 47.02, frame=11), item(16, 47.03)]
    speeds = [item(178, 0, 0, 0, 2, (1, -1, 50, 0)), item(178, 0, 0, 0, 2, (2, 3, -1, 0))]
    jump, fence, rally = item(177, 0, 0, 0, 2, (1, 3, 0, 0)), item(5001, 47.1), item(5100, 47.1)
    path = qgc(tmp_path, [*terrain, *speeds, jump, fence, rally])
    whole = json.loads(path.read_text()) | {
        "geoFence": {"circles": [{}], "polygons": [{}, {}], "version": 2},
        "rallyPoints": {"points": [[47.0, 8.0, 50.0]], "version": 2},
    }
    path.write_text(json.dumps(whole))
    read = read_plan_file(path)
    assert [leg.speed_mps for leg in read.missions[0].legs] == [18, 18, 18]
    assert read.remarks == tuple(
        f"{path}: {line}"
        for line in (
            "item 4: DO_CHANGE_SPEED without a speed is skipped",
            "item 5: DO_CHANGE_SPEED of climb or descent is skipped",
            "item 6: DO_JUMP changes the way or its times; the way is taken without it",
            "item 7: command 5001 is of a geofence, which is not looked at",
            "item 8: a rally point is not flown to",
            "item 1 and 1 more: height above the terrain is taken as above home",
            "geoFence: 3 areas of a geofence, which is not looked at",
            "rallyPoints: 1 rally point, not flown to",
        )
    )


LANDING = {
    "type": "ComplexItem",
    "complexItemType": "fwLandingPattern",
    "landCoordinate": [47.02, 8.0, 0],
    "landingApproachCoordinate": [47.03, 8.0, 40],
}
"""As QGroundControl writes it, without the keys that the way does not depend on."""


def test_a_landing_pattern_is_flown_by_its_approach_to_its_place(tmp_path):
    read = read_plan_file(qgc(tmp_path, [item(16, 47.01), LANDING | {"useDoChangeSpeed": True, "finalApproachSpeed": 9}]))
    assert [leg.end for leg in read.missions[0].legs] == [(47.01, 8.0, 600.0), (47.03, 8.0, 540.0), (47.02, 8.0, 500.0)]
    assert [leg.speed_mps for leg in read.missions[0].legs] == [18, 9, 9]
    assert read.remarks == ()


def test_a_landing_pattern_of_an_older_file_has_its_approach_by_another_name(tmp_path):
    older = {key: value for key, value in LANDING.items() if key != "landingApproachCoordinate"}
    above_sea_level = older | {"loiterCoordinate": [47.03, 8.0, 540], "altitudesAreRelative": False}
    (mission,) = read_plan_file(qgc(tmp_path, [above_sea_level])).missions
    assert [leg.end for leg in mission.legs] == [(47.03, 8.0, 540.0), (47.02, 8.0, 0.0)]
    unplaced = qgc(tmp_path, [LANDING | {"landCoordinate": [147.0, 8.0, 0]}])
    with pytest.raises(DataError, match=r"landCoordinate 1: should be less than or equal to 90, not 147"):
        read_plan_file(unplaced)


def test_an_arc_is_flown_straight_and_a_payload_brought_to_its_place(tmp_path):
    path = qgc(tmp_path, [item(36, 47.01), item(94, 47.02, alt=0)])
    read = read_plan_file(path)
    assert [leg.end[0] for leg in read.missions[0].legs] == [47.01, 47.02]
    assert read.remarks == (f"{path}: item 1: ARC_WAYPOINT is taken as the straight way to its end",)


def test_a_plan_that_names_neither_class_nor_home_says_so_or_goes_without(tmp_path):
    path = qgc(tmp_path, [item(16, 47.01), item(16, 47.02)], vehicleType=0, plannedHomePosition=[0, 0, 0])
    read = read_plan_file(path)
    assert read.missions[0].begin == (47.01, 8.0, 100.0)
    assert read.remarks == (f"{path}: the file states no class of vehicle; a plane is taken, --class sets another one",)


def test_a_plan_of_which_nothing_is_flown_says_what_was_skipped(tmp_path):
    scan = {"type": "ComplexItem", "complexItemType": "StructureScan"}
    with pytest.raises(DataError, match=r"one waypoint; item 1: StructureScan holds no items .* is skipped and 1 more$"):
        read_plan_file(qgc(tmp_path, [scan, item(206)]))


def test_a_copter_of_a_plan_hovers_and_flies_at_its_hover_speed(tmp_path):
    (mission,) = read_plan_file(qgc(tmp_path, [item(16, params=(5, 0, 0, None))], vehicleType=2), None, None).missions
    assert mission.vehicle_class is VehicleClass.MULTIROTOR
    assert (mission.legs[0].speed_mps, mission.legs[0].hold_s, mission.legs[0].radius_m) == (6, 5, 0.0)


def test_a_file_of_mission_planner_gives_home_and_heights_above_it(tmp_path):
    read = read_plan_file(wpl(tmp_path, HOME, ROW, ROW.replace("3\t16", "0\t16").replace("47.01", "47.02")))
    (mission,) = read.missions
    assert mission.begin == (47.0, 8.0, 500.0)
    assert [leg.end for leg in mission.legs] == [(47.01, 8.0, 600.0), (47.02, 8.0, 100.0)]
    assert read.remarks == (
        f"{tmp_path}/a.waypoints: the file states no class of vehicle; a plane is taken, --class sets another one",
        f"{tmp_path}/a.waypoints: the file states no speed; 15 m/s is taken, --speed sets another one",
    )
    told = read_plan_file(tmp_path / "a.waypoints", PerVehicle(VehicleClass.MULTIROTOR), PerVehicle(4.0))
    assert (told.remarks, told.missions[0].vehicle_class) == ((), VehicleClass.MULTIROTOR)


def test_lines_of_comment_and_parameters_that_are_not_used_are_read_as_mavproxy_and_px4_write_them(tmp_path):
    unused = ROW.replace("0\t0\t0\t0\t47.01", "0\t0\t0\tNan\t47.01")
    (mission,) = read_plan_file(wpl(tmp_path, "# the field", HOME, "# north of it", unused)).missions
    assert mission.begin == (47.0, 8.0, 500.0)
    assert [leg.end for leg in mission.legs] == [(47.01, 8.0, 600.0)]
    for wrong in (ROW.replace("47.01", "nan"), ROW.replace("3\t16\t0", "3\t16\tinf")):
        with pytest.raises(DataError, match=r"line 3: .* expected a number"):
            read_plan_file(wpl(tmp_path, HOME, wrong))


def test_a_first_item_that_is_no_waypoint_is_flown_and_is_no_home(tmp_path):
    takeoff = ROW.replace("1\t0\t3\t16", "0\t1\t3\t22").replace("47.01", "47.0")
    (mission,) = read_plan_file(wpl(tmp_path, takeoff, ROW.replace("100", "120"))).missions
    assert mission.begin == (47.0, 8.0, 100.0)
    assert [leg.end for leg in mission.legs] == [(47.01, 8.0, 120.0)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "Invalid JSON: EOF while parsing an object"),
        ("{}", "mission: is missing"),
        ("QGC WPL 120\n", "line 1: is 'QGC WPL 120', expected 'QGC WPL 110'"),
        ("QGC WPL 110\n", "expected home and waypoints after the first line"),
        (f"QGC WPL 110\n{HOME}\n1 2 3\n", "line 3: has 3 columns, expected 12"),
        (f"QGC WPL 110\n{HOME}\n{ROW.replace('47.01', 'north')}\n", "line 3: latitude is 'north', expected a number"),
        (f"QGC WPL 110\n{HOME}\n{ROW.replace('47.01', '147')}\n", "item 1: latitude is 147, expected degrees from -90 to 90"),
        (f"QGC WPL 110\n{HOME}\n{WRONG_FRAME}\n", "item 1: frame is 9, expected one of 0, 3, 5, 6, 10, 11"),
        (f"QGC WPL 110\n{HOME}\n", "expected two places at least: home and one waypoint; the file states no class"),
        ("lat,lon\n1,2\n", "expected a QGroundControl .plan (JSON), 'QGC WPL 110' in the first line, or a scenario"),
    ],
)
def test_a_malformed_file_is_told_with_file_place_and_what_was_expected(tmp_path, text, said):
    path = tmp_path / "bad.txt"
    path.write_text(text)
    with pytest.raises(DataError) as error:
        read_plan_file(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (
            {"type": "SimpleItem", "command": 16, "frame": 3, "params": [1, 2]},
            "params 3: is missing",
        ),
        (
            {"type": "Simple"},
            "type: should be one of 'SimpleItem', 'ComplexItem', not 'Simple'",
        ),
        (item("16"), "command: should be a valid number, not '16'"),
        (item(16, "47"), "params 5: should be a valid number, not '47'"),
        (item(16, math.nan), "params 5: should be a finite number, not nan"),
        (7, "items 1: should be an object, not 7"),
        (item(178, params=(1, 1e-9, -1, 0)), "item 1: speed is 1e-09, expected m/s from 0.1 to 200"),
        (item(178, params=(1, 1e12, -1, 0)), "item 1: speed is 1e+12, expected m/s from 0.1 to 200"),
        (item(16, 10**400), "params 5: should be a finite number, not 100000"),
        (
            {"type": "SimpleItem", "command": 16, "frame": 3, "params": ["x" * 500]},
            "params 1: should be a valid number, not 'xxx",
        ),
    ],
)
def test_a_malformed_item_of_a_plan_is_named_by_its_number(tmp_path, broken, said):
    with pytest.raises(DataError, match=r"a\.plan: (mission: items|item) 1: ") as error:
        read_plan_file(qgc(tmp_path, [broken]))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[mqtt]\nport = 1883\n", "has no [origin] and no [[vehicle]]: expected a scenario of simulated vehicles"),
        ("[origin]\nlat_deg = 47.0\nlon_deg = 8.0\n", "has no [[vehicle]]: expected a scenario of simulated vehicles"),
        ("[origin]\n[[vehicle]]\n", "origin: lat_deg: is missing"),
    ],
)
def test_another_toml_than_a_scenario_is_told_by_what_it_lacks(tmp_path, text, said):
    path = tmp_path / "gcs-coloc.toml"
    path.write_text(text)
    with pytest.raises(DataError) as error:
        read_plan_file(path)
    assert said in str(error.value)


def test_an_integer_of_thousands_of_digits_is_named_at_its_place(tmp_path):
    digits = "9" * 5000
    path = qgc(tmp_path, [item(16, 47.0), item(16, 12345)])
    path.write_text(path.read_text().replace("12345", digits))
    with pytest.raises(DataError, match=r"a\.plan: Invalid JSON: number out of range at line 1 column \d+$"):
        read_plan_file(path)
    toml = scenario(tmp_path, f"[[station]]\nid = {digits}\n")
    with pytest.raises(DataError, match=r"s\.toml: is not valid TOML: a number is too long, or"):
        read_plan_file(toml)
    hexadecimal = scenario(tmp_path, f"[[station]]\nid = 3\neast_m = 0x{digits}\n")
    with pytest.raises(DataError, match=r"s\.toml: station 1: east_m: .*, not a number of thousands of digits$"):
        read_plan_file(hexadecimal)


def test_a_plan_that_is_nested_too_deep_is_told(tmp_path):
    path = qgc(tmp_path, [12345])
    deep = '{"type": "ComplexItem", "TransectStyleComplexItem": {"Items": ['
    path.write_text(path.read_text().replace("12345", deep * 3000 + "]}}" * 3000))
    with pytest.raises(DataError, match="recursion limit exceeded at line 1"):
        read_plan_file(path)


def scenario(tmp_path, more="", top="", vehicle=""):
    """A scenario of one vehicle on a triangle of 10 m; further keys of the top level and of the vehicle, further tables."""
    path = tmp_path / "s.toml"
    lines = ("name = 's'", top, "[origin]", "lat_deg = 47.0", "lon_deg = 8.0", "[[vehicle]]", "sysid = 1", vehicle)
    path.write_text("\n".join([*lines, "waypoints = [[0, 0], [10, 0], [0, 10]]", "", more]))
    return path


@pytest.mark.parametrize(
    ("top", "more", "said"),
    [
        ("station = 5", "", "s.toml: station: should be a list; of tables it is written [[name]] in TOML"),
        ("station = [5]", "", "s.toml: station 1: should be a table"),
        ("", "[[station]]\nid = 70000", "s.toml: station 1: id: should be less than or equal to 65535, not 70000"),
        ("", "[[station]]\nid = -5", "s.toml: station 1: id: should be greater than or equal to 0, not -5"),
        ("", "[[station]]\nid = true", "s.toml: station 1: id: should be a valid integer, not True"),
        (
            "",
            "[[station]]\nid = 1\neast_m = 1e308\nnorth_m = 0",
            "station 1: east_m: should be less than or equal to 300000, not 1e+308",
        ),
        ("airspeed_mps = -5", "", "s.toml: airspeed_mps: should be greater than or equal to 0.1, not -5"),
        ("airspeed_mps = 0", "", "s.toml: airspeed_mps: should be greater than or equal to 0.1, not 0"),
        ("end_of_route = 'spiral'", "", "s.toml: end_of_route: should be 'straight', 'loop' or 'hold', not 'spiral'"),
        ("end_of_route = 5", "", "s.toml: end_of_route: should be 'straight', 'loop' or 'hold', not 5"),
        ("end_of_route = 'hold'\nhold_radius_m = -1", "", "s.toml: hold_radius_m: should be greater than 0, not -1"),
        ("duration_s = 0", "", "s.toml: duration_s: should be greater than 0, not 0"),
        ("duration_s = -5", "", "s.toml: duration_s: should be greater than 0, not -5"),
        ("duration_s = 1e300", "", "s.toml: duration_s: should be less than or equal to 86400, not 1e+300"),
        (
            "duration_s = 86400\nend_of_route = 'loop'",
            "",
            "s.toml: vehicle 1: waypoints: 55673 laps of 34 m are flown in duration_s, expected at most 100000 waypoints in all",
        ),
    ],
)
def test_a_malformed_scenario_is_told_in_one_line(tmp_path, top, more, said):
    with pytest.raises(DataError) as error:
        read_plan_file(scenario(tmp_path, more, top))
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("vehicle", "said"),
    [
        ("airspeed_mps = 0", "vehicle 1: airspeed_mps: should be greater than or equal to 0.1, not 0"),
        ("end_of_route = ''", "vehicle 1: end_of_route: should be 'straight', 'loop' or 'hold', not ''"),
        ("height_m = 1e9", "vehicle 1: height_m: should be less than or equal to 20000, not 1000000000.0"),
    ],
)
def test_a_malformed_vehicle_of_a_scenario_is_named_by_its_number(tmp_path, vehicle, said):
    with pytest.raises(DataError) as error:
        read_plan_file(scenario(tmp_path, vehicle=vehicle))
    assert said in str(error.value)


def test_the_speed_of_a_plan_is_named_where_nothing_flies_at_it(tmp_path):
    with pytest.raises(DataError, match=r"a\.plan: mission: cruiseSpeed is 1e-09, expected m/s from 0\.1 to 200"):
        read_plan_file(qgc(tmp_path, [item(16)], cruiseSpeed=1e-9))


def test_only_the_speed_that_a_plan_is_flown_at_has_to_be_one(tmp_path):
    (copter,) = read_plan_file(qgc(tmp_path, [item(16)], cruiseSpeed=0, vehicleType=2)).missions
    assert copter.legs[0].speed_mps == 6


def test_a_stay_of_any_length_ends_with_the_day(tmp_path):
    turns = item(18, 47.01, 8.01, params=(1e308, 0, 120, None))
    (mission,) = read_plan_file(qgc(tmp_path, [turns])).missions
    assert mission.legs[0].hold_s == 86400.0


def test_a_file_that_cannot_be_read_is_told(tmp_path):
    with pytest.raises(DataError, match="cannot be read: No such file"):
        read_plan_file(tmp_path / "none.plan")
    (tmp_path / "x.plan").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="is no text"):
        read_plan_file(tmp_path / "x.plan")


def test_a_scenario_brings_its_vehicles_stations_and_noise():
    plan = load_plan([SCENARIOS / "stations.toml"])
    assert [vehicle.sysid for vehicle in plan.vehicles] == [4]
    assert sorted(station.station_id for station in plan.stations) == [1, 2, 3, 4]
    configured = StationConfig(id=1, lat_deg=47.0, lon_deg=8.0, alt_m=0.0).sigma_m
    assert {station.sigma_m for station in plan.stations} == {configured} == {1.0}
    assert plan.assumptions.max_range_m == 3000.0
    assert plan.span_s == (0.0, 300.0)
    # Round again from the first waypoint: 3.2 km at 22 m/s is two rounds.
    path = plan.paths[4]
    assert [abs(path.position(at)[:2] - path.position(at + 142.0)[:2]).max() < 250.0 for at in (20.0, 60.0, 100.0)] == [True] * 3


def test_speed_and_class_are_of_all_vehicles_or_of_one(tmp_path):
    plan = qgc(tmp_path, [item(18, 47.01, params=(1, 0, 80, None))])
    files = [plan, SCENARIOS / "two-failed.toml", plan]
    speeds, classes = PerVehicle(10.0, {7: 4.0, 3: 5.0}), PerVehicle(None, {7: VehicleClass.MULTIROTOR, 4: VehicleClass.GROUND})
    read = load_plan(files, speeds_mps=speeds, classes=classes)
    assert [vehicle.sysid for vehicle in read.vehicles] == [1, 2, 3, 4, 5, 6, 7]
    assert {v.sysid: v.legs[0].speed_mps for v in read.vehicles} == {1: 10, 2: 10, 3: 5, 4: 10, 5: 10, 6: 10, 7: 4}
    others = dict.fromkeys((1, 2, 3, 5, 6), VehicleClass.PLANE)
    assert {v.sysid: v.vehicle_class for v in read.vehicles} == {**others, 4: VehicleClass.GROUND, 7: VehicleClass.MULTIROTOR}
    # A plane circles at its own speed, a copter stays.
    assert read.vehicle(6).legs[0].hold_s == pytest.approx(2 * math.pi * 80 / 10)
    assert read.vehicle(7).legs[0].radius_m == 0.0


def test_files_are_numbered_in_their_order_and_start_when_told(tmp_path):
    first = qgc(tmp_path, [item(16, 47.01)])
    plan = load_plan(
        [first, first], starts_s={2: 40.0}, stations=[ListedStation(3, (47.0, 8.02, 510.0))], assumed={"range_sigma_m": 2.0}
    )
    assert [(v.sysid, v.start_s) for v in plan.vehicles] == [(1, 0.0), (2, 40.0)]
    assert plan.stations[0].position_enu_m[0] == pytest.approx(1522.0, abs=5.0)
    assert plan.assumptions.range_sigma_m == 2.0
    with pytest.raises(UsageError, match=r"--start 9=...: there is no vehicle 9; there are 1, 2"):
        load_plan([first, first], starts_s={9: 1.0})
    with pytest.raises(UsageError, match=r"--speed 7=...: there is no vehicle 7; there are 1, 2"):
        load_plan([first, first], speeds_mps=PerVehicle(of_one={7: 10.0}))
    with pytest.raises(UsageError, match="range_sigma_m must be above 0"):
        load_plan([first], assumed={"range_sigma_m": 0.0})


def test_a_place_on_another_continent_is_told_with_its_distance(tmp_path):
    with pytest.raises(UsageError, match=r"a\.plan has a place \d+ km from where the first plan begins, expected one site"):
        load_plan([qgc(tmp_path, [item(16, 7.0)])])
