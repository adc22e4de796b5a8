"""The figures themselves, without a flight: each against what it is made of, by hand."""

from __future__ import annotations

import struct

import pytest
from flight_figures import HEADER, Figures, Sent, Truth, altitude_beyond_2_sigmas, healthy_after_s, median, sent_fixes
from pilot import Place3D
from pymavlink.dialects.v20 import ardupilotmega as mavlink


def test_the_table_has_a_column_for_each_figure():
    names, ruler = HEADER.split("\n")
    assert names.count("|") == ruler.count("|") == Figures("loss").row().count("|")
    row = Figures("loss", ekf_median_m=0.75, altitude_beyond_2_sigmas=0.04, healthy_after_end_s=11.5).row()
    cells = dict(zip(names.strip("| ").split(" | "), row.strip("| ").split(" | "), strict=False))
    assert (cells["EKF median"], cells["alt beyond 2 sigmas"], cells["healthy again"]) == ("0.75", "0.04", "11.50")


def test_the_median_is_not_moved_by_the_few_that_are_far_off():
    assert median([0.5, 0.75, 1.0, 0.25, 90.0]) == 0.75
    assert median([]) is None


@pytest.mark.parametrize(("off_m", "share"), [(0.0, 0.0), (3.9, 0.0), (4.1, 0.5), (-4.1, 0.5)])
def test_altitudes_count_against_the_vertical_accuracy_stated_with_them(off_m, share):
    # It climbs at 10 m/s, so that an age of 0.1 s is a metre.
    truth = Truth([Place3D(0.1 * k, 47.0, 8.0, 100.0 + k) for k in range(50)])
    right = Sent(Place3D(2.0, 47.0, 8.0, 119.0), 1.0, 2.0, 3)
    off = Sent(Place3D(3.0, 47.0, 8.0, 129.0 + off_m), 1.0, 2.0, 3)
    unknown = Sent(Place3D(9.0, 47.0, 8.0, 500.0), 1.0, 2.0, 3)
    assert altitude_beyond_2_sigmas([right, off, unknown], truth, 0.1) == share
    assert altitude_beyond_2_sigmas([unknown], truth, 0.1) is None


def test_healthy_again_is_from_when_on_it_stayed_so():
    flickered = [(4.0, 4, "failed"), (12.0, 4, "recovering"), (15.0, 4, "healthy"), (16.0, 4, "suspect"), (18.0, 1, "healthy")]
    assert healthy_after_s([*flickered, (21.5, 4, "healthy")], 4, 10.0) == 11.5
    assert healthy_after_s(flickered, 4, 10.0) is None
    assert healthy_after_s([(4.0, 4, "healthy")], 4, 10.0) is None


def test_what_was_sent_is_read_with_both_of_its_accuracies(tmp_path):
    service = mavlink.MAVLink(None, srcSystem=254, srcComponent=191)
    fix = mavlink.MAVLink_gps_input_message(
        0, 1, 0, 0, 0, 3, 470000000, 80000000, 512.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.3, 1.5, 2.5, 7
    )
    place = mavlink.MAVLink_global_position_sensor_message(4, 1, 1, 0, 0, 0, 0, 470000000, 80000000, 560.0, 512.0, 1.25, 3.5)
    file = tmp_path / "flight.tlog"
    file.write_bytes(b"".join(struct.pack(">Q", 5_000_000) + message.pack(service) for message in (fix, place)))
    found = [(s.place.unix_s, s.place.alt_m, s.accuracy_m, s.vertical_accuracy_m, s.fix_type) for s in sent_fixes(file)]
    assert found == [(5.0, 512.0, 1.5, 2.5, 3), (5.0, 512.0, 1.25, 3.5, 3)]
