from __future__ import annotations

import re
from pathlib import Path

import pytest

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    OdometryMeasurement,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClass,
)
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.evaluation.dataset import read_dataset

FILES = {
    "meta.toml": """
name = "small"
source = "made up"
licence = "CC0"
dims = 3
[origin]
lat_deg = 47.0
lon_deg = 8
alt_m = 400.0
[[node]]
id = "tag"
role = "denied"
[[node]]
id = "A"
role = "anchor"
e_m = 0.0
n_m = 0.0
u_m = 2.0
sigma_m = 0.02
[[node]]
id = "B"
role = "peer"
""",
    "positions.csv": "t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m,ve_mps,vn_mps,vu_mps,sigma_vel_mps,arrival_s\n"
    "0.0,tag,1,2,3,1,1,0,0,0,0.5,0.2\n0.5,B,10,2,3,1,1.5,5,0,0,0.5,0.6\n",
    "ranges.csv": "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,3.5,0.2\n1.1,tag,B,9,0.2\n",
    "altitude.csv": "t_s,id,u_m,sigma_v_m\n1.0,tag,3.0,1.0\n",
    "attitude.csv": "t_s,id,roll_rad,pitch_rad,yaw_rad,airspeed_mps\n1.0,tag,0.1,0.0,1.5,20\n",
    "truth.csv": "t_s,id,e_m,n_m,u_m\n1.0,tag,1.1,2.0,3.0\n1.5,tag,1.2,2.0,3.0\n",
}


def write(directory: Path, **changed: str | None) -> Path:
    for name, text in FILES.items():
        text = changed.get(name.replace(".", "_"), text)
        if text is not None:
            (directory / name).write_text(text)
    return directory


def test_everything_is_read(tmp_path):
    dataset = read_dataset(write(tmp_path))
    assert (dataset.name, dataset.dims, dataset.origin) == ("small", 3, (47.0, 8.0, 400.0))
    assert [(n.id, n.vehicle, n.role) for n in dataset.nodes] == [("tag", 1, "denied"), ("A", 2, "anchor"), ("B", 3, "peer")]
    assert dataset.nodes[1].place_enu_m == (0.0, 0.0, 2.0)
    assert PositionMeasurement(3, 0.5, 0.6, (10.0, 2.0, 3.0), 1.0, 1.5, (5.0, 0.0, 0.0), 0.5) in dataset.measurements
    assert RangeMeasurement(1, 2, 1.0, 1.0, 3.5, 0.2) in dataset.measurements
    assert AltitudeMeasurement(1, 1.0, 1.0, 3.0, 1.0) in dataset.measurements
    assert AttitudeMeasurement(1, 1.0, 1.0, 0.1, 0.0, 1.5, 20.0) in dataset.measurements
    assert [m.arrived_at_s for m in dataset.measurements] == sorted(m.arrived_at_s for m in dataset.measurements)
    assert dataset.truth[1].positions_enu_m.tolist() == [[1.1, 2.0, 3.0], [1.2, 2.0, 3.0]]


def test_a_data_set_is_named_by_a_string_as_well(tmp_path):
    assert read_dataset(str(write(tmp_path))).name == "small"


def test_optional_files_and_columns_may_be_left_out(tmp_path):
    positions = "t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m\n0.0,tag,1,2,3,1,1\n"
    dataset = read_dataset(write(tmp_path, altitude_csv=None, attitude_csv=None, positions_csv=positions))
    assert len(dataset.measurements) == 3


def test_ranges_alone_do(tmp_path):
    others = ("altitude_csv", "attitude_csv", "positions_csv", "truth_csv")
    dataset = read_dataset(write(tmp_path, **dict.fromkeys(others)))
    assert len(dataset.measurements) == 2
    assert dataset.truth == {}


RANGES = "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,3.5,0.2\n"


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("1.1,tag,A,-0.3,0.2", "column 4 (range_m): -0.3 must not be negative"),
        ("1.1,tag,A,nan,0.2", "column 4 (range_m): 'nan' is not a finite number"),
        ("1.1,tag,A", "column 4: 3 cells where the header has 5"),
        ("1.1,tag,Z,3,0.2", "column 3 (to_id): 'Z' is not the id of any node"),
    ],
)
def test_a_bad_row_is_left_out_and_its_place_is_told(tmp_path, row, problem):
    dataset = read_dataset(write(tmp_path, ranges_csv=f"{RANGES}{row}\n1.2,tag,B,9,0.2\n"))
    assert sum(isinstance(m, RangeMeasurement) for m in dataset.measurements) == 2
    (lost,) = dataset.dropped
    assert (lost.path.name, lost.count, lost.rows) == ("ranges.csv", 1, 3)
    assert f"line 3, {problem}" in lost.first[0]


def test_a_file_that_is_mostly_bad_is_an_error(tmp_path):
    with pytest.raises(DataError, match=r"line 3, column 4 \(range_m\).*2 of 3 rows are wrong"):
        read_dataset(write(tmp_path, ranges_csv=f"{RANGES}1,tag,A,-1,1\n2,tag,A,-1,1\n"))


def test_a_calibrated_device_measures_the_distance(tmp_path):
    meta = FILES["meta.toml"].replace('role = "denied"', 'role = "denied"\nrange_bias_m = 0.25\nrange_scale = 0.01')
    meta = meta.replace("sigma_m = 0.02", "sigma_m = 0.02\nrange_bias_m = -0.05")
    m = next(m for m in read_dataset(write(tmp_path, meta_toml=meta)).measurements if isinstance(m, RangeMeasurement))
    assert m.range_m == pytest.approx((3.5 - 0.20) / 1.01)


def test_the_class_of_the_set_holds_for_nodes_that_state_none_but_anchors(tmp_path):
    meta = 'vehicle_class = "indoor"\n' + FILES["meta.toml"].replace('role = "peer"', 'role = "peer"\nvehicle_class = "ground"')
    nodes = read_dataset(write(tmp_path, meta_toml=meta)).nodes
    assert [node.vehicle_class for node in nodes] == [VehicleClass.INDOOR, None, VehicleClass.GROUND]
    assert all(node.vehicle_class is None for node in read_dataset(write(tmp_path)).nodes)


BAD_ROWS = [
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.1,tag,B,nine,0.2\n", "line 2, column 4 (range_m)"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,nan,0.2\n", "line 2, column 4 (range_m)"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,-1,0.2\n", "line 2, column 4 (range_m)"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,3,0\n", "line 2, column 5 (sigma_m)"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,C,3,1\n", "line 2, column 3 (to_id)"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,tag,3,1\n", "line 2, column 3 (to_id)"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,3\n", "line 2, column 5"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,A,3,1,7\n", "line 2, column 6"),
    ("ranges_csv", "t_s,from_id,to_id,range,sigma_m\n1.0,tag,A,3,1\n", "line 1, column 4"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m,arrival_s\n1.0,tag,A,3,1,0.5\n", "line 2, column 6 (arrival_s)"),
    ("ranges_csv", "", "line 1, column 1"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n", "no rows"),
    ("positions_csv", "t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m\n0,A,1,2,3,1,1\n", "line 2, column 2 (id)"),
    ("positions_csv", "t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m,ve_mps\n0,tag,1,2,3,1,1,3\n", "line 1, column 8"),
    ("truth_csv", "t_s,id,e_m,n_m,u_m\n", "no row of any denied vehicle"),
    ("truth_csv", "t_s,id,e_m,n_m,u_m\n1,B,1,2,3\n", "no row of any denied vehicle"),
    ("truth_csv", "t_s,id,e_m,n_m,u_m\n2,tag,1,2,3\n1,tag,1,2,3\n0,tag,1,2,3\n", "line 3, column 1 (t_s)"),
    ("attitude_csv", "t_s,id,roll_rad,pitch_rad,yaw_rad,airspeed_mps\n1,tag,0,0,inf,20\n", "line 2, column 5 (yaw_rad)"),
    (
        "attitude_csv",
        "t_s,id,roll_rad,pitch_rad,yaw_rad,airspeed_mps\n1,tag,0,4.5,1,20\n",
        "column 4 (pitch_rad): 4.5 is not within",
    ),
    (
        "attitude_csv",
        "t_s,id,roll_rad,pitch_rad,yaw_rad,airspeed_mps\n1,tag,30,0,1,20\n",
        "column 3 (roll_rad): 30 is not within",
    ),
    ("truth_csv", "t_s,id,e_m,n_m,u_m\n1,tag,473566000,2,3\n", "line 2, column 3 (e_m): 4.73566e+08 is not within"),
    (
        "ranges_csv",
        "t_s,from_id,to_id,range_m,range_m\n1.0,tag,A,3.5,0.2\n",
        "line 1, column 4: two columns are called 'range_m'",
    ),
    ("altitude_csv", "t_s,id,u_m,sigma_v_m\n1,tag,,1\n", "line 2, column 3 (u_m)"),
    ("altitude_csv", "t_s,id,u_m,sigma_v_m\n1,tag,1e300,1\n", "column 3 (u_m): 1e+300 is not within"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1.7e12,tag,A,3,1\n", "seconds are wanted"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1,tag,A,3,1e300\n", "column 5 (sigma_m): 1e+300 is not within"),
    ("ranges_csv", "t_s,from_id,to_id,range_m,sigma_m\n1,tag,A,3,1e-200\n", "column 5 (sigma_m): 1e-200 is not within"),
    ("truth_csv", "t_s,id,e_m,n_m,u_m\n-1e300,tag,1,2,3\n", "column 1 (t_s): -1e+300 is not within"),
    ("meta_toml", FILES["meta.toml"].replace("e_m = 0.0", "e_m = 1e300"), "e_m: should be less than or equal to 20000000"),
    ("meta_toml", FILES["meta.toml"].replace("sigma_m = 0.02", "sigma_m = 1e300"), "sigma_m: should be less than or equal to"),
    ("meta_toml", FILES["meta.toml"] + "range_bias_m = 1e200", "range_bias_m: should be less than or equal to"),
    ("meta_toml", FILES["meta.toml"] + "range_scale = -0.5", "excess over 1"),
    ("meta_toml", "name = ", "is not valid TOML"),
    ("meta_toml", FILES["meta.toml"] + '[[node.antenna]]\nid = "x"\nforward_m = 1', "right_m"),
    ("meta_toml", FILES["meta.toml"] + "range_scale = 1.01", "excess over 1"),
    (
        "meta_toml",
        'vehicle_class = "kite"\n' + FILES["meta.toml"],
        "vehicle_class: should be 'plane', 'multirotor', 'ground', 'boat' or 'indoor', not 'kite'",
    ),
    ("meta_toml", FILES["meta.toml"].replace("dims = 3", "dims = 4"), "dims"),
    ("meta_toml", FILES["meta.toml"].replace('"peer"', '"friend"'), "role"),
    ("meta_toml", FILES["meta.toml"].replace('id = "B"', 'id = "A"'), "two nodes"),
    ("meta_toml", FILES["meta.toml"].replace('"denied"', '"peer"'), "nothing to locate"),
    ("meta_toml", FILES["meta.toml"].replace("e_m = 0.0", ""), "e_m"),
    ("meta_toml", FILES["meta.toml"].replace("dims = 3", "dims = 3\ncolour = 1"), "colour"),
]


@pytest.mark.parametrize(("name", "text", "where"), BAD_ROWS, ids=[f"{n}-{w}" for n, _, w in BAD_ROWS])
def test_what_is_wrong_is_named_with_its_place(tmp_path, name, text, where):
    with pytest.raises(DataError) as raised:
        read_dataset(write(tmp_path, **{name: text}))
    assert name.replace("_csv", ".csv").replace("_toml", ".toml") in str(raised.value)
    assert where in str(raised.value)


@pytest.mark.parametrize("name", ["meta.toml", "ranges.csv"])
def test_a_missing_file_is_named(tmp_path, name):
    with pytest.raises(DataError, match=name.replace(".", r"\.")):
        read_dataset(write(tmp_path, **{name.replace(".", "_"): None}))


@pytest.mark.parametrize("name", ["meta.toml", "ranges.csv", "truth.csv"])
def test_a_file_of_a_data_set_stands_for_the_data_set(tmp_path, name):
    named, whole = read_dataset(write(tmp_path) / name), read_dataset(tmp_path)
    assert (named.name, named.nodes, named.measurements) == (whole.name, whole.nodes, whole.measurements)


def test_a_directory_of_data_sets_names_them(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write(tmp_path / name)
    with pytest.raises(DataError, match=r"it has data sets in it: a, b; state one of them, or .*/\*"):
        read_dataset(tmp_path)


def test_a_missing_directory_is_named(tmp_path):
    with pytest.raises(DataError, match="no such directory"):
        read_dataset(tmp_path / "nothing")


def test_bytes_that_are_no_text_are_named(tmp_path):
    write(tmp_path)
    (tmp_path / "truth.csv").write_bytes(b"t_s,id,e_m,n_m,u_m\n\xff\xfe")
    with pytest.raises(DataError, match="truth"):
        read_dataset(tmp_path)


STATION = """[[station]]
id = 3
name = "mast"
lat_deg = 47.0
lon_deg = 8.0
alt_m = 412.0
sigma_m = 0.5
range_bias_m = 0.25
"""


def test_a_station_is_an_anchor_that_ranges_name_by_its_id(tmp_path):
    ranges = "t_s,from_id,to_id,range_m,sigma_m\n1.0,tag,STN3,9.25,0.2\n"
    dataset = read_dataset(write(tmp_path, meta_toml=FILES["meta.toml"] + STATION, ranges_csv=ranges))
    station = dataset.nodes[-1]
    assert (station.id, station.vehicle, station.role, station.sigma_m) == ("STN3", station_node(3), "anchor", 0.5)
    assert station.place_enu_m == pytest.approx((0.0, 0.0, 12.0), abs=1e-6)
    assert RangeMeasurement(1, station_node(3), 1.0, 1.0, 9.0, 0.2) in dataset.measurements


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ((STATION, "[station]\nid = 3\n"), "station: should be a list; of tables it is written [[name]] in TOML"),
        (("id = 3", 'id = "mast"'), "station 1: id: should be a valid integer, not 'mast'"),
        (("alt_m = 412.0", ""), "station 1: alt_m: is missing"),
        (
            ("lat_deg = 47.0\nlon_deg = 8.0\nalt_m = 412", "lat_deg = 147.0\nlon_deg = 8.0\nalt_m = 412"),
            "lat_deg: should be less than or equal to 90, not 147.0",
        ),
        (("sigma_m = 0.5", "sigma_m = 0"), "sigma_m: should be greater than 0, not 0"),
        (('name = "mast"', "place = 1"), "station 1: place: unknown key; see the reference of this file"),
        (("[origin]\nlat_deg = 47.0\nlon_deg = 8\nalt_m = 400.0\n", ""), "needs [origin]"),
        (('role = "peer"', ""), "node 3: role: is missing"),
        (('role = "peer"', 'role = "boss"'), "node 3: role: should be one of 'denied', 'peer', 'subject', 'anchor', not 'boss'"),
    ],
)
def test_a_station_that_is_wrong_is_told_with_its_remedy(tmp_path, changed, told):
    meta = (FILES["meta.toml"] + STATION).replace(*changed)
    with pytest.raises(DataError, match=re.escape(told)):
        read_dataset(write(tmp_path, meta_toml=meta))


def test_two_stations_of_one_id_are_an_error(tmp_path):
    with pytest.raises(DataError, match="two nodes have the id 'STN3'"):
        read_dataset(write(tmp_path, meta_toml=FILES["meta.toml"] + STATION + STATION))


ODOMETRY = "t_s,id,forward_mps,right_mps,turn_radps,sigma_vel_mps,sigma_turn_radps\n"


def test_odometry_is_read_and_a_wrong_row_is_told_with_its_place(tmp_path):
    directory = write(tmp_path)
    rows = "1.0,tag,1.5,-0.1,0.2,0.05,0.02\n1.1,tag,1.5,0,0.2,0,0.02\n1.2,tag,1.5,0,0.2,0.05,0.02\n1.3,A,1,0,0,0.05,0.02\n"
    (directory / "odometry.csv").write_text(ODOMETRY + rows)
    dataset = read_dataset(directory)
    assert OdometryMeasurement(1, 1.0, 1.0, 1.5, -0.1, 0.2, 0.05, 0.02) in dataset.measurements
    (dropped,) = dataset.dropped
    assert dropped.count == 2
    assert "odometry.csv, line 3, column 6 (sigma_vel_mps): 0 has to be above 0" in dropped.first[0]
    assert "line 5, column 2 (id): an anchor does not move" in dropped.first[1]


def test_a_turn_rate_in_degrees_is_told(tmp_path):
    directory = write(tmp_path)
    (directory / "odometry.csv").write_text(ODOMETRY + "1.0,tag,1.5,0,40,0.05,0.02\n")
    with pytest.raises(DataError, match="radians a second are wanted"):
        read_dataset(directory)
