"""Lever arms: what they add to the range between two bodies."""

from math import pi

import pytest

from gcs_coloc.core.measurements import AttitudeMeasurement, RangeMeasurement
from gcs_coloc.evaluation.antennas import Attitudes, antenna_range, body_to_enu
from gcs_coloc.evaluation.dataset import read_dataset
from gcs_coloc.evaluation.evaluate import dataset_findings

ANCHOR = {2: (10.0, 0.0, 0.0)}


def facing(yaw_rad, roll_rad=0.0):
    return Attitudes([AttitudeMeasurement(1, 1.0, 1.0, roll_rad, 0.0, yaw_rad, None)])


def ranged(range_m, attitudes, arm=(0.5, 0.0, 0.0), at_s=1.0):
    return antenna_range(RangeMeasurement(1, 2, at_s, at_s, range_m, 0.1), (arm, (0.0, 0.0, 0.0)), attitudes, ANCHOR)


@pytest.mark.parametrize(
    ("body", "angles", "enu"),
    [
        ((1, 0, 0), (0, 0, 0), (0, 1, 0)),
        ((1, 0, 0), (0, 0, pi / 2), (1, 0, 0)),
        ((0, 1, 0), (0, 0, 0), (1, 0, 0)),
        ((0, 1, 0), (pi / 2, 0, 0), (0, 0, -1)),
        ((1, 0, 0), (0, pi / 2, 0), (0, 0, 1)),
        ((0, 0, 1), (0, 0, 1.0), (0, 0, -1)),
    ],
)
def test_a_body_is_turned_as_its_attitude_says(body, angles, enu):
    assert body_to_enu(body, *angles) == pytest.approx(enu, abs=1e-12)


@pytest.mark.parametrize(("yaw_rad", "offset"), [(pi / 2, (-0.5, 0.0, 0.0)), (-pi / 2, (0.5, 0.0, 0.0))])
def test_an_antenna_towards_the_anchor_measures_less_and_one_away_more(yaw_rad, offset):
    found = ranged(10.0, facing(yaw_rad))
    assert found.offset_enu_m == pytest.approx(offset)
    assert (found.range_m, found.sigma_m) == (10.0, 0.1)
    # From the body's reference point the anchor seems to be as near as the antenna is to it.
    assert found.virtual_end(2, ANCHOR[2]) == pytest.approx((10.0 + offset[0], 0.0, 0.0))
    assert found.virtual_end(1, (0.0, 0.0, 0.0)) == pytest.approx((-offset[0], 0.0, 0.0))


@pytest.mark.parametrize(("attitudes", "at_s"), [(Attitudes([]), 1.0), (facing(0.0), 9.0)])
def test_what_is_unknown_goes_into_the_sigma(attitudes, at_s):
    found = ranged(10.0, attitudes, at_s=at_s)
    assert found.offset_enu_m == (0.0, 0.0, 0.0)
    assert found.sigma_m == pytest.approx((0.1**2 + 0.5**2 / 3) ** 0.5)


def test_an_attitude_of_just_before_holds():
    assert ranged(10.0, facing(0.0), at_s=1.4).sigma_m == 0.1


def test_antennas_of_a_data_set_are_read(tmp_path):
    (tmp_path / "meta.toml").write_text("""
name = "two tags"
source = "made"
licence = "CC0"
dims = 3
[[node]]
id = "body"
role = "denied"
[[node.antenna]]
id = "left"
forward_m = 0.0
right_m = -0.3
down_m = 0.0
[[node]]
id = "A"
role = "anchor"
e_m = 10.0
n_m = 0.0
u_m = 0.0
sigma_m = 0.01
[[node.antenna]]
id = "mast"
forward_m = 0.0
right_m = 0.0
down_m = -2.0
""")
    (tmp_path / "ranges.csv").write_text(
        "t_s,from_id,to_id,range_m,sigma_m,antenna_from,antenna_to\n1,body,A,10,0.1,left,mast\n1,body,A,10,0.1,,\n1,body,A,9,0.1,right,\n"
    )
    (tmp_path / "attitude.csv").write_text("t_s,id,roll_rad,pitch_rad,yaw_rad,airspeed_mps\n1,body,0,0,0,\n")
    dataset = read_dataset(tmp_path)
    one, plain = (m for m in dataset.measurements if isinstance(m, RangeMeasurement))
    assert one.offset_enu_m == pytest.approx((0.3, 0.0, 2.0))
    assert plain.offset_enu_m == (0.0, 0.0, 0.0)
    assert (one.device_id, plain.device_id) == (3, 0)
    finding, *_ = dataset_findings(dataset)
    assert "1 of 3 rows of ranges.csv are wrong and left out" in finding.text
    assert "'right' is not the id of any antenna of 'body'" in finding.text
