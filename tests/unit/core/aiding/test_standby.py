"""Standby: a healthy vehicle is streamed its own estimate, where its autopilot stays with its own receiver."""

from __future__ import annotations

from itertools import pairwise

import pytest
from engine_flights import StraightLine, aids, fly, parameters_told, settings, vehicle_4

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand
from gcs_coloc.core.messages.outbound import AidingMessage, Notice, ParameterRequest


def standing_by(**values: float) -> tuple[Engine, StraightLine]:
    estimator = StraightLine()
    engine = Engine(estimator, settings(aiding=AidingSettings(standby=True)))
    fly(engine, 0.0, 2.0)
    parameters_told(engine, 2.0, **values)
    return engine, estimator


def test_standby_streams_a_healthy_vehicle_its_own_estimate_and_leaves_it_an_anchor():
    engine, estimator = standing_by(GPS_AUTO_SWITCH=4.0, GPS_PRIMARY=0.0)
    stream = aids(fly(engine, 2.0, 10.0), 4)
    assert len(stream) == pytest.approx(80, abs=3)
    assert {a.fix_type for _, a in stream} == {3}
    seen = vehicle_4(engine, 10.0)
    assert seen.gps_state == "healthy"
    assert seen.aiding.startswith("standby: sending 3D fix")
    assert max(m.measured_at_s for m in estimator.of(PositionMeasurement, 4)) > 9.5
    assert not engine.decision(4).is_aided


def test_standby_fails_over_without_a_gap():
    engine, _ = standing_by(GPS_AUTO_SWITCH=4.0, GPS_PRIMARY=0.0)
    stream = aids(fly(engine, 2.0, 10.0), 4) + aids(fly(engine, 10.0, 20.0, failed=[4]), 4)
    assert {a.fix_type for _, a in stream} == {3}
    times = [t for t, _ in stream]
    assert [b - a for a, b in pairwise(times)] == pytest.approx([0.1] * (len(times) - 1), abs=1e-6)
    assert vehicle_4(engine, 20.0).aiding.startswith("sending 3D fix")


def test_one_that_is_located_anew_when_it_fails_is_aided_as_soon_as_it_is_located():
    """Its receiver was found faulty, and what it reported of late is out of its estimate; meanwhile it follows that receiver."""
    engine, estimator = standing_by(GPS_AUTO_SWITCH=4.0, GPS_PRIMARY=0.0)
    fly(engine, 2.0, 10.0)
    engine.receive(OperatorCommand(4, 10.0, GpsOverride.FAILED))
    estimator.unknown = "waiting for ranges to start from"
    unlocated = aids(fly(engine, 10.0, 10.8), 4)
    estimator.unknown = None
    located = aids(fly(engine, 10.8, 12.0), 4)
    assert {a.fix_type for _, a in unlocated} == {1}
    assert {a.fix_type for _, a in located} == {3}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"GPS_AUTO_SWITCH": 1.0, "GPS_PRIMARY": 0.0}, "GPS_AUTO_SWITCH=1 could leave its own receiver for ours: set it to 4"),
        ({"GPS_AUTO_SWITCH": 4.0, "GPS_PRIMARY": 1.0}, "GPS_PRIMARY=1 is our receiver"),
        ({"GPS_AUTO_SWITCH": 4.0}, "it has not told its GPS_AUTO_SWITCH and GPS_PRIMARY yet"),
    ],
)
def test_standby_waits_for_parameters_by_which_the_vehicle_stays_with_its_own_receiver(values, words):
    engine, _ = standing_by(**values)
    assert not aids(fly(engine, 2.0, 10.0), 4)
    assert words in vehicle_4(engine, 10.0).aiding
    assert len(aids(fly(engine, 10.0, 14.0, failed=[4]), 4)) > 25  # aid needs none of it


def test_what_stands_against_standby_is_told_once_and_only_when_the_vehicle_has_told_its_parameters():
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(standby=True)))
    silent = fly(engine, 0.0, 5.0)
    parameters_told(engine, 5.0, GPS_AUTO_SWITCH=1.0, GPS_PRIMARY=0.0)
    told = fly(engine, 5.0, 10.0)
    assert not [o for _, o in silent if isinstance(o, Notice) and "no standby" in o.text]
    assert len([o for _, o in told if isinstance(o, Notice) and "no standby" in o.text]) == 1


def test_without_standby_a_healthy_vehicle_gets_nothing():
    engine = Engine(StraightLine(), settings())
    out = fly(engine, 0.0, 5.0)
    assert not [o for _, o in out if isinstance(o, AidingMessage | ParameterRequest)]
