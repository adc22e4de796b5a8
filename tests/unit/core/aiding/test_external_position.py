"""External position estimates: sent where GPS_INPUT is too coarse for the EKF, watched, and never beside a fix that is used."""

from __future__ import annotations

from itertools import pairwise

import pytest
from engine_flights import M_APART_NORTH, StraightLine, fly, settings

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import TransmitDisabled
from gcs_coloc.core.messages.inbound import (
    CommandOutcome,
    CommandResult,
    EkfStatus,
    ParameterValue,
    PeerRange,
    TimeBase,
    VehicleCommand,
)
from gcs_coloc.core.messages.outbound import ExternalPosition, GpsInput, Notice, ParameterRequest

ACCEPTED, DENIED, FAILED = CommandOutcome.ACCEPTED, CommandOutcome.DENIED, CommandOutcome.FAILED
UNSUPPORTED = CommandOutcome.UNSUPPORTED
COMMAND = VehicleCommand.EXTERNAL_POSITION_ESTIMATE


def flown(engine: Engine, start_s: float, stop_s: float, result=None, checks: float | None = None, aligned=False) -> list:
    """Fly on without GPS on vehicle 4, which answers to estimates with `result` and to the question for its checks.

    `aligned`: its EKF reports an absolute position.
    """
    out = []
    for step in range(round(start_s * 10), round(stop_s * 10)):
        t = step / 10
        engine.receive(EkfStatus(4, t, aligned, not aligned, gps_glitching=False))
        engine.receive(PeerRange(4, t, 1, 3.0 * M_APART_NORTH, 2.0, None, TimeBase.SERVICE, step, None, 0))
        for at_s, output in fly(engine, t, t + 0.1, failed=[4]):
            out.append((at_s, output))
            if isinstance(output, ExternalPosition) and result is not None:
                engine.receive(CommandResult(4, at_s, COMMAND, result))
            if isinstance(output, ParameterRequest) and output.name == "EK3_GPS_CHECK" and checks is not None:
                engine.receive(ParameterValue(4, at_s, "EK3_GPS_CHECK", checks, 4))
    return out


def engine_with(sigma_m: float, **aid) -> Engine:
    estimator = StraightLine()
    estimator.sigma_m = sigma_m
    # These tests are on what the vehicle takes; the alert limit has its own.
    engine = Engine(estimator, settings(aiding=AidingSettings(alert_limit_m=300.0, **aid)))
    fly(engine, 0.0, 5.0)
    return engine


def of(out: list, kind: type) -> list:
    return [(t, o) for t, o in out if isinstance(o, kind)]


def fix_types(out: list, after_s: float) -> set[int]:
    return {o.fix_type for t, o in of(out, GpsInput) if t >= after_s}


def texts(out: list) -> list[str]:
    return [o.text for _, o in of(out, Notice)]


def test_a_position_that_the_ekf_takes_goes_by_gps_input_alone():
    out = flown(engine_with(2.0), 5.0, 15.0, ACCEPTED)
    assert not of(out, ExternalPosition)
    assert fix_types(out, 7.0) == {3}


def test_a_coarse_position_goes_by_estimates_once_the_vehicle_takes_them_and_gps_input_says_no_fix():
    engine = engine_with(10.0)
    out = flown(engine, 5.0, 20.0, ACCEPTED)
    estimates = of(out, ExternalPosition)
    gaps = [b - a for (a, _), (b, _) in pairwise(estimates)]
    assert gaps == pytest.approx([1.0] * len(gaps), abs=0.11)
    assert len(gaps) > 8
    assert fix_types(out, estimates[1][0]) == {1}
    assert estimates[0][1].accuracy_m == 10.0
    frame = engine.frame
    sent_at_s, last = estimates[-1]
    east_m, _, _ = frame.enu_from_geodetic(last.lat_deg, last.lon_deg, 530.0)
    assert east_m == pytest.approx(20.0 * sent_at_s, abs=0.01)  # where it is when the command arrives, not 0.2 s before
    assert last.sent_s == pytest.approx(sent_at_s, abs=0.01)
    assert "external position estimates, for it is too coarse" in engine.snapshot(20.0).vehicles[3].aiding
    assert engine.snapshot(20.0).vehicles[3].aiding_has_fix


def test_a_height_that_is_not_known_is_stated_and_the_horizontal_position_goes_by_estimates_without_one():
    engine = engine_with(2.0)
    engine.estimator._inner.sigma_v_m = 80.0
    out = flown(engine, 5.0, 20.0, ACCEPTED)
    stated = [o for t, o in of(out, GpsInput) if o.fix_type == 3 and t > 5.5]
    assert {o.vert_accuracy_m for o in stated} == {80.0}
    assert {o.horiz_accuracy_m for o in stated} == {2.0}
    assert len(of(out, ExternalPosition)) > 8  # of which none has a height
    assert fix_types(out, 8.0) == {1}
    assert any("vertical accuracy 80.0 m, it takes 11.25 m" in text for text in texts(out))
    assert engine.snapshot(20.0).vehicles[3].sigma_v_m == 80.0


def test_a_vehicle_that_does_not_check_it_and_flies_its_barometer_keeps_its_fix_however_little_the_height_is_known():
    engine = engine_with(2.0)
    engine.estimator._inner.sigma_v_m = 80.0
    out = flown(engine, 5.0, 15.0, ACCEPTED, checks=23.0)
    assert fix_types(out, 8.0) == {3}
    assert {o.vert_accuracy_m for t, o in of(out, GpsInput) if t > 8.0} == {80.0}


def test_where_the_vehicle_refuses_them_gps_input_goes_on_and_the_refusals_are_counted_and_told_once():
    engine = engine_with(10.0)
    out = flown(engine, 5.0, 20.0, FAILED)
    assert fix_types(out, 7.0) == {3}
    assert engine.refused()["external_position_failed"] > 8
    assert len([text for text in texts(out) if "refuses external position estimates (failed)" in text]) == 1


def test_beside_gps_input_that_an_aligned_ekf_fuses_no_estimate_is_sent():
    """Aligned, EKF3 went on fusing a GPS of 21 m, and refused each of 39 to 67 estimates a flight."""
    engine = engine_with(21.0)
    out = flown(engine, 5.0, 20.0, FAILED, aligned=True)
    assert not of(out, ExternalPosition)
    assert fix_types(out, 7.0) == {3}
    assert not [text for text in texts(out) if "coarse" in text]
    dead_reckoning = flown(engine, 20.0, 30.0, FAILED)
    assert len(of(dead_reckoning, ExternalPosition)) >= 4
    aligned_again = flown(engine, 30.0, 35.0, FAILED, aligned=True)
    assert not of(aligned_again, ExternalPosition)
    assert "its EKF has an absolute position again: GPS_INPUT alone" in texts(aligned_again)


def test_a_firmware_that_does_not_know_them_is_asked_once():
    out = flown(engine_with(10.0), 5.0, 20.0, UNSUPPORTED)
    assert len(of(out, ExternalPosition)) == 1
    assert fix_types(out, 7.0) == {3}


def test_a_vehicle_that_does_not_answer_keeps_its_gps_input_and_is_told_of_once():
    out = flown(engine_with(10.0), 5.0, 25.0, None)
    assert fix_types(out, 7.0) == {3}
    assert texts(out).count("it does not answer to external position estimates") == 1


def test_a_vehicle_is_held_not_to_answer_after_five_estimates():
    out = flown(engine_with(10.0), 5.0, 20.0)
    told_at_s = next(t for t, o in of(out, Notice) if "it does not answer" in o.text)
    assert len([t for t, _ in of(out, ExternalPosition) if t < told_at_s]) == 5


def test_where_nothing_is_on_the_air_no_answer_is_missed():
    engine = engine_with(10.0)
    engine.receive(TransmitDisabled(5.0))
    out = flown(engine, 5.0, 25.0, None)
    assert of(out, ExternalPosition)
    assert not [text for text in texts(out) if "does not answer" in text or "not taken" in text]


def test_the_vehicles_own_checks_decide_what_is_coarse():
    out = flown(engine_with(10.0), 5.0, 15.0, ACCEPTED, checks=17.0)  # satellites and yaw alone
    assert not [t for t, _ in of(out, ExternalPosition) if t > 8.0]
    assert fix_types(out, 13.0) == {3}


def test_a_position_that_is_good_again_goes_back_to_gps_input_after_a_while():
    engine = engine_with(10.0)
    flown(engine, 5.0, 12.0, ACCEPTED)
    engine.estimator._inner.sigma_m = 2.0
    out = flown(engine, 12.0, 22.0, ACCEPTED)
    assert min(t for t, o in of(out, GpsInput) if o.fix_type == 3) == pytest.approx(17.0, abs=0.31)
    assert not [t for t, _ in of(out, ExternalPosition) if t > 17.5]


def test_no_estimate_is_sent_while_the_position_may_not_be_claimed():
    engine = engine_with(60.0)  # its protection level is beyond the alert limit
    out = flown(engine, 5.0, 15.0, ACCEPTED)
    assert not of(out, ExternalPosition)
    assert fix_types(out, 5.0) == {1}


@pytest.mark.parametrize("sigma_m", [2.0, 10.0])
def test_chosen_by_setting_they_are_sent_alone(sigma_m):
    out = flown(engine_with(sigma_m, method="external_position"), 5.0, 15.0, ACCEPTED)
    assert not of(out, GpsInput)
    assert len(of(out, ExternalPosition)) == pytest.approx(9, abs=1)


def test_answers_to_other_commands_mean_nothing():
    engine = engine_with(10.0)
    flown(engine, 5.0, 8.0, None)
    engine.receive(CommandResult(4, 8.0, VehicleCommand.OTHER, ACCEPTED))
    assert fix_types(flown(engine, 8.0, 10.0, None), 8.0) == {3}
