"""A PX4 is sent what its parameters show that it takes, with an accuracy that holds for its filter, and shows that it uses it."""

from __future__ import annotations

from math import cos, exp, hypot, radians, sqrt

import numpy as np
import pytest
from engine_flights import StraightLine, fly, parameters_told, settings, texts, vehicle_4

from gcs_coloc.core.aiding.methods.method import FixInputs, Moment
from gcs_coloc.core.aiding.methods.px4_positions import CorrelatedPositions, px4_local_m
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.inbound import Autopilot, EkfStatus, GlobalOrigin
from gcs_coloc.core.messages.outbound import (
    AidingMessage,
    ExternalPosition,
    GlobalPositionSensor,
    GpsInput,
    OriginRequest,
    ParameterRequest,
    VisionPosition,
)

AGP = {"EKF2_AGP0_CTRL": 1.0, "EKF2_AGP0_ID": 1.0}
ORIGIN = GlobalOrigin(4, 2.0, 47.001, 8.002, 480.0)


def on_px4(told: dict[str, float], **aiding: object) -> Engine:
    """A fleet of PX4, of which vehicle 4 told these parameters, at 5 s; it was asked for others in vain."""
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(**aiding)))
    fly(engine, 0.0, 2.0, autopilot=Autopilot.PX4)
    for at_s in (2.0, 3.0):  # of the other slots it is asked when the first one is known
        parameters_told(engine, at_s, **told)
        fly(engine, at_s, at_s + 1.0, autopilot=Autopilot.PX4)
    fly(engine, 4.0, 5.0, autopilot=Autopilot.PX4)
    return engine


def lost(engine: Engine, until_s: float = 10.0) -> list:
    return fly(engine, 5.0, until_s, failed=[4], autopilot=Autopilot.PX4)


def of(out: list, kind: type) -> list:
    return [(t, o) for t, o in out if isinstance(o, kind) and o.sysid == 4]


def test_global_position_sensor_holds_where_it_is_on_arrival():
    engine = on_px4(AGP)
    out = lost(engine)
    sent = of(out, GlobalPositionSensor)
    assert not of(out, GpsInput)
    assert len(sent) > 35
    sent_at_s, last = sent[-1]
    assert last.epv_m == 3.0
    east_m, _, up_m = engine.frame.enu_from_geodetic(last.lat_deg, last.lon_deg, last.alt_msl_m)
    assert (east_m, up_m) == pytest.approx((20.0 * sent_at_s, 30.0), abs=0.01)
    assert vehicle_4(engine, 10.0).aiding == "sending GLOBAL_POSITION_SENSOR"


def test_what_is_not_sent_yet_is_said_to_be_so():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 2.0, failed=[4], autopilot=Autopilot.PX4)
    assert vehicle_4(engine, 2.0).aiding == "NOT SENT: it has not told yet which positions its EKF2 takes"
    parameters_told(engine, 2.0, **AGP)
    assert vehicle_4(engine, 2.0).aiding == "not sent yet"


def test_a_prediction_is_not_taken_for_where_it_is():
    """An altitude becomes an up coordinate over that place."""
    engine, off_m = on_px4(AGP), []
    lost(engine, 7.0)
    for step in range(70, 100):
        fly(engine, step / 10, step / 10 + 0.1, failed=[4], autopilot=Autopilot.PX4)
        place = engine._review.last_round(4).located_enu_m
        assert place is not None
        off_m.append(abs(place[0] - 2.0 * step))
    assert max(off_m) < 3.0
    assert engine.close() == []


def test_a_px4_that_is_not_located_is_sent_nothing():
    engine = on_px4(AGP)
    engine.estimator._inner.unknown = "no ranges"
    out = lost(engine)
    assert not of(out, AidingMessage)
    assert "not located, sending nothing: no ranges" in texts(out)


@pytest.mark.parametrize(
    ("told", "sent"),
    [
        (AGP, {GlobalPositionSensor}),
        (AGP | {"EKF2_EV_CTRL": 1.0}, {GlobalPositionSensor}),
        ({"EKF2_AGP0_CTRL": 1.0, "EKF2_AGP0_ID": 7.0, "EKF2_AGP2_CTRL": 1.0, "EKF2_AGP2_ID": 1.0}, {GlobalPositionSensor}),
        ({"EKF2_AGP_CTRL": 1.0, "EKF2_EV_CTRL": 1.0}, {VisionPosition}),  # PX4 1.15 to 1.17
        ({"EKF2_EV_CTRL": 9.0}, {VisionPosition}),
        ({}, {GlobalPositionSensor}),  # it answers nothing: what it may take does no harm
        ({"EKF2_EV_CTRL": 0.0}, set()),
        ({"EKF2_AGP_CTRL": 1.0, "EKF2_EV_CTRL": 0.0}, set()),
        ({"EKF2_AGP0_CTRL": 1.0, "EKF2_AGP0_ID": 0.0}, set()),  # the slot is off
        ({"EKF2_AGP0_CTRL": 0.0, "EKF2_AGP0_ID": 1.0}, set()),
    ],
)
def test_it_is_sent_what_its_parameters_show_that_it_takes_and_else_nothing(told, sent):
    engine = on_px4(told)
    engine.receive(ORIGIN)
    assert {type(o) for _, o in of(lost(engine), AidingMessage)} == sent
    inhibit = vehicle_4(engine, 10.0).inhibit_reason
    assert (inhibit is None) is bool(sent)
    assert inhibit is None or "its EKF2 takes no position; gcs-coloc doctor names the settings" in inhibit


ERROR = "needs aid and cannot be aided"


@pytest.mark.parametrize(
    ("told", "later", "error"),
    [
        # As they come in: what the second part says decides, and nothing is said before.
        ({"EKF2_EV_CTRL": 0.0}, AGP, None),
        ({"EKF2_AGP0_CTRL": 1.0}, {"EKF2_AGP0_ID": 1.0, "EKF2_EV_CTRL": 0.0}, None),
        ({"EKF2_AGP0_CTRL": 1.0}, {"EKF2_AGP0_ID": 0.0, "EKF2_EV_CTRL": 0.0}, "its EKF2 takes no position"),
        # The reading of the others fails.
        ({"EKF2_EV_CTRL": 0.0}, {}, "its EKF2 takes no position"),
    ],
)
def test_a_px4_without_gps_from_the_start_is_said_to_take_nothing_only_once_it_is_known(told, later, error):
    engine = Engine(StraightLine(), settings())
    early = fly(engine, 0.0, 0.5, failed=[4], autopilot=Autopilot.PX4)
    parameters_told(engine, 0.5, **told)
    early += fly(engine, 0.5, 1.8, failed=[4], autopilot=Autopilot.PX4)
    inhibit = vehicle_4(engine, 1.8)
    assert (inhibit.gps_state, inhibit.inhibit_reason) == ("failed", "it has not told yet which positions its EKF2 takes")
    assert not [text for text in texts(early) if ERROR in text]
    parameters_told(engine, 1.8, **later)
    errors = [text for text in texts(fly(engine, 1.8, 8.0, failed=[4], autopilot=Autopilot.PX4)) if ERROR in text]
    assert len(errors) == (1 if error else 0)
    assert all(error in text for text in errors)


def test_its_parameters_are_requested_before_it_needs_aid():
    engine = Engine(StraightLine(), settings())
    requested = {o.name for _, o in of(fly(engine, 0.0, 2.0, autopilot=Autopilot.PX4), ParameterRequest)}
    assert requested == {"EKF2_AGP0_CTRL", "EKF2_AGP0_ID", "EKF2_EV_CTRL"}
    parameters_told(engine, 2.0, **AGP)
    fly(engine, 2.0, 3.0, autopilot=Autopilot.PX4)
    assert not of(fly(engine, 3.0, 60.0, autopilot=Autopilot.PX4), ParameterRequest)


def test_external_position_estimates_are_never_streamed_to_a_px4():
    """They are a hard reset there, of wind and velocity too: the vehicle went into failsafe while it acknowledged them."""
    engine = on_px4(AGP, method="external_position")
    out = lost(engine)
    assert not of(out, ExternalPosition)
    assert any("PX4 takes an external position estimate as a reset" in text for text in texts(out))


def test_vision_positions_are_from_the_origin_that_it_reports_and_wait_for_it():
    engine = on_px4({"EKF2_EV_CTRL": 1.0})
    first = lost(engine, 8.0)
    assert not of(first, VisionPosition)
    assert "it has not reported the origin" in vehicle_4(engine, 8.0).aiding
    assert len(of(first, OriginRequest)) in (1, 2)
    engine.receive(ORIGIN)
    sent_at_s, last = of(fly(engine, 8.0, 10.0, failed=[4], autopilot=Autopilot.PX4), VisionPosition)[-1]
    lat_deg, lon_deg, alt_m = engine.frame.geodetic_from_enu(20.0 * sent_at_s, 3 * 111.2, 30.0)
    assert (last.north_m, last.east_m) == pytest.approx(px4_local_m(ORIGIN, lat_deg, lon_deg))
    assert last.down_m == pytest.approx(480.0 - alt_m)
    assert last.variance_m2[2] == pytest.approx(9.0)


@pytest.mark.parametrize(("north_m", "east_m"), [(0.0, 0.0), (700.0, -300.0), (-3000.0, 9000.0)])
def test_the_local_frame_is_that_of_px4s_projection_on_a_sphere(north_m, east_m):
    lat_deg = 47.001 + np.degrees(north_m / 6_371_000.0)
    lon_deg = 8.002 + np.degrees(east_m / (6_371_000.0 * cos(radians(lat_deg))))
    found = px4_local_m(ORIGIN, lat_deg, lon_deg)
    assert found == pytest.approx((north_m, east_m), abs=0.05 + 2.0 * hypot(north_m, east_m) ** 2 / 6_371_000.0)


def estimate(variance_m2: float, at_s: float = 0.0, ranges: int = 3) -> Estimate:
    covariance = np.diag([variance_m2, variance_m2, 9.0, 0.1, 0.1, 0.1])
    return Estimate(4, at_s, np.zeros(3), np.zeros(3), covariance, 1.0, ranges)


def moment(now_s: float, where: Estimate, ahead_m2: float) -> Moment:
    ahead = lambda node, at_s: estimate(ahead_m2, at_s)  # noqa: E731
    known = FixInputs(False, False, False, None, None, None, None, (), ahead, lambda at_s: None)
    return Moment(now_s, now_s, None, None, where, None, known, standby=False, transmits=True)


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 10.0, 50.0])
@pytest.mark.parametrize("time_constant_s", [0.5, 2.0, 6.0])
def test_the_accuracy_is_stated_for_as_many_positions_as_are_independent(rate_hz, time_constant_s):
    """The mean of many positions with errors of one time constant has the variance that their number, so corrected, gives it."""
    factor = CorrelatedPositions(1.0 / rate_hz).factor(moment(0.0, estimate(1.0), exp(1.0 / time_constant_s)), estimate(1.0))
    rho, count = exp(-1.0 / (rate_hz * time_constant_s)), 20_000
    k = np.arange(1, count)
    variance_of_mean = (1.0 + 2.0 * np.sum((1.0 - k / count) * rho**k)) / count
    assert factor / sqrt(count) == pytest.approx(sqrt(variance_of_mean), rel=0.02)


def test_a_filter_that_takes_them_for_independent_is_as_sure_as_it_may_be():
    """EKF2 at ten positions a second was 5.5 times too sure; of correlated errors its estimate is to be off as it states."""
    time_constant_s, sigma_m, period_s = 6.0, 3.6, 0.1
    factor = CorrelatedPositions(period_s).factor(moment(0.0, estimate(1.0), exp(1.0 / time_constant_s)), estimate(1.0))
    assert off_over_stated(time_constant_s, sigma_m, period_s, 1.0) > 3.0
    assert 0.6 < off_over_stated(time_constant_s, sigma_m, period_s, factor) < 1.3


def off_over_stated(time_constant_s: float, sigma_m: float, period_s: float, factor: float) -> float:
    """Rms error over stated accuracy of a filter of position and velocity with EKF2's accelerometer noise, on one axis."""
    random, rho = np.random.default_rng(7), exp(-period_s / time_constant_s)
    f = np.array([[1.0, period_s], [0.0, 1.0]])
    noise = 0.35**2 * 0.01  # EKF2_ACC_NOISE for 10 ms
    q = noise * np.array([[period_s**3 / 3, period_s**2 / 2], [period_s**2 / 2, period_s]])
    x, p, error_m, offs, stated = np.zeros(2), np.diag([sigma_m**2, 0.25]), 0.0, [], []
    for _ in range(30_000):
        error_m = rho * error_m + sigma_m * sqrt(1.0 - rho**2) * random.standard_normal()
        x, p = f @ x, f @ p @ f.T + q
        gain = p[:, 0] / (p[0, 0] + (sigma_m * factor) ** 2)
        x, p = x + gain * (error_m - x[0]), p - np.outer(gain, p[0])
        offs.append(x[0])
        stated.append(p[0, 0])
    return float(np.sqrt(np.mean(np.square(offs)) / np.mean(stated)))


def test_without_ranges_nothing_is_taken_for_forgotten():
    correlated = CorrelatedPositions(0.1)
    with_ranges = correlated.factor(moment(0.0, estimate(1.0), 1.5), estimate(1.0))
    without = estimate(4.0, 5.0, ranges=0)
    assert correlated.factor(moment(5.0, without, 40.0), without) == with_ranges


@pytest.mark.parametrize(
    ("told", "flags", "acknowledged", "words"),
    [
        # As flown with PX4 of August 2026: (bit 512, bit 256) of ESTIMATOR_STATUS.
        (AGP, (True, True), True, None),  # 895
        (AGP, (False, True), False, "(gcs-coloc doctor names the settings): its EKF2 reports no"),  # 383
        (AGP, None, None, None),
        ({"EKF2_EV_CTRL": 1.0}, (False, True), True, None),  # 383
        (
            {"EKF2_EV_CTRL": 1.0},
            (False, False),
            False,
            "no horizontal aid, though a vision position is sent",
        ),  # 127
    ],
)
def test_its_filter_shows_whether_it_uses_the_position_while_its_own_gps_is_gone(told, flags, acknowledged, words):
    engine = on_px4(told)
    engine.receive(ORIGIN)
    out = []
    for at_s in range(5, 25):
        if flags is not None:
            engine.receive(EkfStatus(4, float(at_s), True, False, False, *flags))
        out += fly(engine, float(at_s), at_s + 1.0, failed=[4], autopilot=Autopilot.PX4)
    assert vehicle_4(engine, 25.0).fix_acknowledged is acknowledged
    alarms = [text for text in texts(out) if "the position is not taken" in text]
    assert len(alarms) == (1 if acknowledged is False else 0)
    assert all(words in text for text in alarms)
