"""GPS_INPUT holds the position of as long ago as the vehicle's EKF takes it to be, and a dilution that fits its accuracy."""

from __future__ import annotations

import math

import pytest
from engine_flights import LON, M_PER_DEGREE_EAST, StraightLine, aids, fly, parameters_told, settings

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import ParameterRequest


def sent_late_s(lag_s: float, told: dict[str, float]) -> float:
    """By how much the position in GPS_INPUT is older than the message."""
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(lag_s=lag_s)))
    fly(engine, 0.0, 2.0)
    requested = {o.name for _, o in fly(engine, 2.0, 5.0, failed=[4]) if isinstance(o, ParameterRequest)}
    assert {"GPS2_DELAY_MS", "GPS_DELAY_MS2"} <= requested
    parameters_told(engine, 5.0, **told)
    at_s, fix = aids(fly(engine, 5.0, 6.0, failed=[4]), 4)[-1]
    return at_s - (fix.lon_deg - LON) * M_PER_DEGREE_EAST / 20.0


@pytest.mark.parametrize(
    ("told", "delay_s"),
    [
        ({}, 0.1),
        ({"GPS2_DELAY_MS": 0.0}, 0.1),  # the driver's 0.2 s, of which EKF3's buffer leaves 0.1 s
        ({"GPS2_DELAY_MS": 220.0}, 0.22),
        ({"GPS_DELAY_MS2": 150.0}, 0.15),  # its name before ArduPilot 4.6
        ({"GPS2_DELAY_MS": 4000.0}, 0.25),
    ],
)
def test_the_position_is_of_as_long_ago_as_the_vehicles_parameter_says(told, delay_s):
    without_s = sent_late_s(0.0, {})
    assert sent_late_s(AidingSettings().lag_s, told) - without_s == pytest.approx(delay_s, abs=0.001)


def test_without_ranges_the_dilution_fits_the_accuracy_as_the_ekf_relates_them():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 2.0)
    _, fix = aids(fly(engine, 2.0, 5.0, failed=[4]), 4)[-1]
    assert fix.horiz_accuracy_m == 2.0
    assert fix.hdop == pytest.approx(math.hypot(2.0, 1.0) / 2.0)  # 5 m of accuracy and an HDOP of 2.5 are EKF3's limits
    assert fix.vdop == pytest.approx(3.0 / 2.0)
