"""Traffic lights never look better than things are, and say why; ellipses are the covariance's."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fleet_views import HEALTHY, LOCATED, LOST, fleet_view

from gcs_coloc.core.alarms.alarms import traffic_light
from gcs_coloc.web.picture import ellipse, fleet_frame


@pytest.mark.parametrize(
    ("vehicle", "colour", "words"),
    [
        (HEALTHY, "good", "fix type 3, 10 satellites"),
        (replace(HEALTHY, inhibit_reason="PX4 does not take GPS_INPUT"), "caution", "PX4 does not take GPS_INPUT"),
        (replace(HEALTHY, gps_state="suspect", gps_reason="only 3 satellites"), "caution", "only 3 satellites"),
        (replace(HEALTHY, gps_state="unknown", gps_reason="nothing heard"), "unknown", "nothing heard"),
        (
            replace(HEALTHY, aiding_override="on", aiding="sending 3D fix", aiding_has_fix=True),
            "caution",
            "aiding switched on by the operator",
        ),
        (replace(HEALTHY, fix_acknowledged=False, aiding="standby: sending 3D fix, NOT TAKEN"), "caution", "NOT TAKEN"),
        (replace(LOCATED, fix_acknowledged=True), "caution", "sending 3D fix"),
        (replace(LOCATED, fix_acknowledged=False, aiding="sending 3D fix, NOT TAKEN"), "bad", "NOT TAKEN"),
        (LOCATED, "caution", "Located within 7 m (95 %); sending 3D fix"),
        (replace(LOCATED, gps_state="recovering"), "caution", "GPS recovering"),
        (replace(LOCATED, aiding_has_fix=False, aiding="NOT SENT: one address"), "bad", "NOT SENT: one address"),
        (LOST, "bad", "Located nowhere: no ranges for 12 s; sending no fix"),
        (replace(HEALTHY, age_s=3.1), "bad", "not heard for 3 s"),
        (replace(LOCATED, age_s=9.0), "bad", "not heard for 9 s"),
    ],
)
def test_the_worst_that_holds_decides_the_colour_and_is_named(vehicle, colour, words):
    got, reason = traffic_light(vehicle, 0.0)
    assert got == colour
    assert words in reason


def test_a_light_stays_as_it_is_while_the_host_s_lag_explains_the_silence():
    view = replace(fleet_view(10.0, replace(HEALTHY, age_s=6.1)), loop_lag_s=6.0)
    [vehicle] = fleet_frame(view).vehicles
    assert (vehicle.light, vehicle.reason) == ("good", "GPS healthy: fix type 3, 10 satellites")
    [vehicle] = fleet_frame(replace(view, loop_lag_s=0.2)).vehicles
    assert (vehicle.light, vehicle.reason[:11]) == ("bad", "not heard f")


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.5, 2.9])
def test_the_ellipse_has_the_axes_of_the_covariance(angle):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    P = turn @ np.diag([9.0, 1.0]) @ turn.T
    e = ellipse((P[0, 0], P[0, 1], P[1, 1]))
    assert (e.semi_major_m, e.semi_minor_m) == pytest.approx((6.0, 2.0))
    assert math.sin(e.angle_rad - angle) == pytest.approx(0.0, abs=1e-9)  # an axis has no direction


def test_a_position_that_is_unknown_has_no_ellipse_and_the_frame_says_all_of_the_view():
    view = fleet_view(10.0, HEALTHY, LOST)
    frame = fleet_frame(view)
    assert [v.snapshot for v in frame.vehicles] == list(view.vehicles)
    assert frame.vehicles[1].ellipse is None
    assert (frame.ranges, frame.at_s) == (view.ranges, 10.0)
