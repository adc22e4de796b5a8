"""RANGING_BEACON for PX4: which ranges are handed over, when, stamped how, with what accuracy; and the closed loop."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from math import dist, hypot, sqrt

import numpy as np
import pytest

from gcs_coloc.core.aiding.inhibit import InhibitReason
from gcs_coloc.core.aiding.methods.method import FixInputs, MethodContext, Moment
from gcs_coloc.core.aiding.methods.ranging_beacon import LEAST_INTERVAL_S, RangingBeaconMethod, VettedRanges
from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate, NoEstimate, NoEstimateReason, RangeMeasurement, Residual, Unlocated
from gcs_coloc.core.messages.control import RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat
from gcs_coloc.core.messages.outbound import RangingBeacon
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.core.stations.stations import Station, StationPosition
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.study.closed_loop import fly
from sitl_fakes.fleet import STEP_S, Fleet
from sitl_fakes.flight import VehicleTruth
from sitl_fakes.geodesy import WorldFrame
from sitl_fakes.scenario import Scenario, load_scenario

FRAME = LocalFrame(47.0, 8.0, 500.0)
BOOT_MINUS_SERVICE_S = 1000.0
MAST = station_node(3)
SPEED_MPS = 20.0
EPOCH_S = 1_780_000_000.0


def located(node: int, at_s: float) -> Estimate:
    """Vehicle 4 flies east, vehicle 1 hovers 300 m north of its line with 2 m east and 1 m north, the mast stands."""
    if node == 4:
        place, velocity, sigmas = (SPEED_MPS * at_s, 0.0, 100.0), (SPEED_MPS, 0.0, 0.0), (30.0, 30.0, 2.0)
    elif node == 1:
        place, velocity, sigmas = (0.0, 300.0, 100.0), (0.0, 0.0, 0.0), (2.0, 1.0, 3.0)
    else:
        place, velocity, sigmas = (500.0, 0.0, 100.0), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5)
    covariance = np.diag([*(s * s for s in sigmas), 0.25, 0.25, 0.04])
    return Estimate(node, at_s, np.array(place), np.array(velocity), covariance, None, 1)


def distance_m(peer: int, at_s: float) -> float:
    return dist(located(4, at_s).position_enu_m, located(peer, at_s).position_enu_m)


def vetted(peer: int, at_s: float, error_m: float = 0.0) -> RangeMeasurement:
    return RangeMeasurement(4, peer, at_s, at_s, distance_m(peer, at_s) + error_m, 0.5)


def moment(
    now_s: float, *ranges: RangeMeasurement, inhibit=None, locate=located, boot_s=lambda at_s: at_s + BOOT_MINUS_SERVICE_S
):
    return Moment(
        now_s,
        now_s,
        FRAME,
        None,
        located(4, now_s),
        StatedReason(inhibit) if inhibit is not None else None,
        FixInputs(False, False, False, None, None, None, None, ranges, locate, boot_s),
        standby=False,
        transmits=True,
    )


def method() -> RangingBeaconMethod:
    return RangingBeaconMethod(MethodContext(4, 0.0, AidingSettings(), Parameters(), Counter(), lambda: None))


def sent(built) -> RangingBeacon | None:
    assert len(built) <= 1
    return built[0] if built else None


def test_a_fresh_range_goes_out_as_measured_with_the_others_position_on_the_vehicles_clock():
    message = sent(method().build_messages(moment(10.0, vetted(MAST, 9.9, 0.3))))
    assert message is not None
    assert message.range_m == pytest.approx(distance_m(MAST, 9.9) + 0.3)
    assert message.boot_us == round((9.9 + BOOT_MINUS_SERVICE_S) * 1e6)
    assert FRAME.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m) == pytest.approx(
        (500.0, 0.0, 100.0), abs=1e-3
    )
    assert (message.sysid, message.beacon_id) == (4, 3)
    assert message.accuracy_m == pytest.approx(hypot(0.5, 0.5))


def test_the_accuracy_holds_the_peers_uncertainty_along_the_line_of_sight_alone():
    message = sent(method().build_messages(moment(0.0, vetted(1, 0.0))))  # due north of vehicle 4
    assert message is not None
    assert message.accuracy_m == pytest.approx(hypot(0.5, 1.0))
    assert message.beacon_id == 256 + 1  # apart from the stations' ids
    assert message.sigma_h_m == pytest.approx(sqrt(2.5))


def test_ranges_of_a_burst_are_spread_and_each_brought_to_the_time_of_its_stamp():
    handed, out = method(), []
    burst = (vetted(MAST, 10.0), vetted(1, 10.001))
    for step in range(5):
        now_s = 10.02 + 0.07 * step
        out.append(sent(handed.build_messages(moment(now_s, *(burst if step == 0 else ())))))
    messages = [m for m in out if m is not None]
    assert [m.beacon_id for m in messages] == [3, 257]
    stamps_s = [m.boot_us / 1e6 - BOOT_MINUS_SERVICE_S for m in messages]
    assert stamps_s[1] - stamps_s[0] >= LEAST_INTERVAL_S - 1e-6
    for message, peer, stamp_s in zip(messages, (MAST, 1), stamps_s, strict=True):
        assert message.range_m == pytest.approx(distance_m(peer, stamp_s), abs=1e-3)


def test_a_late_range_is_brought_forward_to_where_the_filter_still_takes_it_and_counts_as_less_sure():
    message = sent(method().build_messages(moment(10.0, vetted(MAST, 9.5))))
    assert message is not None
    stamp_s = message.boot_us / 1e6 - BOOT_MINUS_SERVICE_S
    assert stamp_s == pytest.approx(9.8)
    assert message.range_m == pytest.approx(distance_m(MAST, 9.8))
    assert message.accuracy_m == pytest.approx(sqrt(0.5**2 + 0.5**2 + 0.3**2 * 0.5))  # two velocities of 0.5 m/s each
    assert sent(method().build_messages(moment(10.0, vetted(MAST, 8.9)))) is None  # too old


def test_messages_keep_their_distance_and_all_peers_have_their_turn():
    handed, out = method(), []
    for step in range(200):
        now_s = 10.0 + 0.02 * step
        ranges = (vetted(MAST, now_s), vetted(1, now_s))
        message = sent(handed.build_messages(moment(now_s, *ranges)))
        if message is not None:
            out.append(message)
    stamps_us = [m.boot_us for m in out]
    assert min(np.diff(stamps_us)) >= LEAST_INTERVAL_S * 1e6 - 1
    assert len(out) == pytest.approx(4.0 / 0.08, abs=3)
    assert [m.beacon_id for m in out[:4]] == [3, 257, 3, 257]
    assert [m.sequence for m in out[:3]] == [1, 2, 3]


@pytest.mark.parametrize("inhibit", [InhibitReason.BEYOND_ALERT_LIMIT, InhibitReason.UNDETERMINED, InhibitReason.REGAINING])
def test_where_no_position_can_be_stated_ranges_go_on(inhibit):
    handed = method()
    assert sent(handed.build_messages(moment(10.0, vetted(MAST, 10.0), inhibit=inhibit))) is not None
    assert handed.without_fix() == "ranges alone by RANGING_BEACON"


@pytest.mark.parametrize("inhibit", [InhibitReason.RANGES_INCONSISTENT, InhibitReason.RANGES_JUMPED])
def test_ranges_that_may_be_wrong_are_not_handed_over(inhibit):
    handed = method()
    assert handed.build_messages(moment(10.0, vetted(MAST, 10.0), inhibit=inhibit)) == []
    assert handed.build_messages(moment(10.1)) == []  # nor later
    assert handed.without_fix() == "nothing"


def test_without_a_place_or_the_vehicles_clock_nothing_is_sent():
    assert method().build_messages(moment(10.0, vetted(MAST, 10.0), boot_s=lambda _: None)) == []
    nowhere = lambda node, at_s: NoEstimate(node, at_s, Unlocated(NoEstimateReason.OTHER, detail="not located"))  # noqa: E731
    assert method().build_messages(moment(10.0, vetted(MAST, 10.0), locate=nowhere)) == []


def test_only_a_range_that_has_to_be_brought_to_another_time_needs_a_place_of_the_vehicle():
    """One peer tells of no place, and its ranges help the autopilot all the same."""

    def peers_alone(node: int, at_s: float) -> Estimate | NoEstimate:
        nowhere = NoEstimate(node, at_s, Unlocated(NoEstimateReason.TOO_UNCERTAIN, 300.0))
        return nowhere if node == 4 else located(node, at_s)

    message = sent(method().build_messages(moment(10.0, vetted(1, 9.9, 0.3), locate=peers_alone)))
    assert message is not None
    assert message.range_m == pytest.approx(distance_m(1, 9.9) + 0.3)
    assert message.boot_us == round((9.9 + BOOT_MINUS_SERVICE_S) * 1e6)
    assert message.accuracy_m == pytest.approx(hypot(0.5, 3.0))  # the peer's uncertainty along its worst direction
    assert sent(method().build_messages(moment(10.0, vetted(1, 9.5), locate=peers_alone))) is None


def measured(peer: int, at_s: float, vehicle: int = 4, device_id: int = 0) -> RangeMeasurement:
    return RangeMeasurement(vehicle, peer, at_s, at_s, 100.0 + device_id, 0.5, device_id)


def residual(peer: int, at_s: float, refused: str | None = None, vehicle: int = 4) -> Residual:
    return Residual(vehicle, peer, at_s, 0.1, 0.5, 0.04, 1, refused)


def test_only_what_the_estimator_used_of_trusted_nodes_is_vetted():
    ranges = VettedRanges(lambda sysid: sysid == 4)
    for peer in (1, 2, 3):
        ranges.add_range(measured(peer, 1.0))
    ranges.add_range(measured(4, 1.0, vehicle=5))  # measured by the other end
    found = [residual(1, 1.0), residual(2, 1.0, "gate"), residual(3, 1.0), residual(4, 1.0, vehicle=5), residual(9, 1.0)]
    ranges.add_residuals(found, lambda node: node != 3)
    assert [(m.from_vehicle, m.to_vehicle) for m in ranges.drain(4)] == [(4, 1), (5, 4)]
    assert ranges.drain(4) == ()


@pytest.mark.parametrize(
    ("outcomes", "vetted_m"), [((None, None), [101.0, 102.0]), ((None, "gate"), []), (("gate", None), []), ((None,), [])]
)
def test_of_two_devices_that_range_a_peer_at_one_time_both_are_vetted_or_neither(outcomes, vetted_m):
    """A residual does not name its device."""
    ranges = VettedRanges(lambda sysid: sysid == 4)
    for device_id in (1, 2, 2):  # the second is heard by two links
        ranges.add_range(measured(1, 1.0, device_id=device_id))
    for refused in outcomes:
        ranges.add_residuals([residual(1, 1.0, refused)], lambda _: True)
    assert [one.range_m for one in ranges.drain(4)] == vetted_m


def test_nothing_is_kept_of_vehicles_that_want_none_and_little_of_those_that_take_none():
    ranges = VettedRanges(lambda sysid: sysid == 4)
    ranges.add_range(measured(1, 1.0, vehicle=5))
    ranges.add_residuals([residual(1, 1.0, vehicle=5)], lambda _: True)
    assert ranges.drain(5) == ()
    for step in range(1000):
        ranges.add_range(measured(1, float(step)))
        ranges.add_residuals([residual(1, float(step))], lambda _: True)
    assert len(ranges.drain(4)) == 64


def test_the_wire_has_millimetres_and_the_height_above_the_sea():
    message = RangingBeacon(4, 61_250_000, 3, 7, 812.5, 0.25, 47.1234567, 8.5432109, 488.0, 0.5, 1.0)
    (frame,) = Decoder(own_sysid=1, own_compid=1).decode(Encoder().encode(message, "there"), 0.0)
    assert frame.message is None  # addressed to vehicle 4, and not measured by its sender
    (frame,) = Decoder(own_sysid=4, own_compid=1).decode(Encoder().encode(message, "there"), 0.0)
    heard = frame.message
    assert (heard.range_m, heard.sigma_m, heard.measured_at_s, heard.beacon.beacon_id) == (812.5, 0.25, 61.25, 3)
    place = heard.beacon.position
    assert (place.lat_deg, place.lon_deg, place.alt_m, place.is_msl) == (47.1234567, 8.5432109, 488.0, True)
    with pytest.raises(ValueError, match="not finite"):
        Encoder().encode(RangingBeacon(4, 1, 3, 7, float("nan"), 0.25, 47.0, 8.0, 488.0, 0.5, 1.0), "there")


def px4_alone(stations: tuple[int, ...]):
    """A PX4 that fuses ranges, without GPS after 20 s, over a field with some stations; and settings that hand it the ranges."""
    scenario = load_scenario("stations")
    vehicle = scenario.vehicle[0].model_copy(
        update={
            "autopilot": "px4",
            "params": {"EKF2_RNGBC_CTRL": 1.0, "EKF2_RNGBC_NOISE": 0.5, "EKF2_AGP0_CTRL": 0.0},
            "ranges_to_stations": list(stations),
        }
    )
    o = scenario.origin
    frame = WorldFrame(o.lat_deg, o.lon_deg, o.alt_msl_m, o.geoid_height_m)
    placed = tuple(
        Station(s.id, "", StationPosition(*frame.to_lla(s.east_m, s.north_m, s.height_m), 0.1, 0.1)) for s in scenario.station
    )
    settings = EngineSettings(aiding=AidingSettings(method="ranging_beacon"), stations=placed)
    bad_air = scenario.dead_reckoning.model_copy(update={"airspeed_wander": 0.08, "heading_wander_deg": 4.0})
    forwarded = scenario.ranging.model_copy(update={"message": "debug_vect"})
    return scenario.model_copy(update={"vehicle": [vehicle], "dead_reckoning": bad_air, "ranging": forwarded}), settings


def autopilot_errors_m(truths: Iterable[VehicleTruth], from_s: float) -> list[float]:
    return [hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m) for t in truths if t.at_s >= from_s]


def aided(scenario: Scenario, settings: EngineSettings, duration_s: float) -> list[VehicleTruth]:
    flight = fly(scenario, 7, Engine(load_estimator("fleet", {}), settings), duration_s=duration_s)
    return [sample.truth for sample in flight.samples[4]]


def alone(scenario: Scenario, duration_s: float) -> Iterator[VehicleTruth]:
    """The same flight without a service, seen as often."""
    fleet = Fleet(scenario, 7, EPOCH_S)
    for step in range(round(duration_s / STEP_S) + 1):
        fleet.advance(step * STEP_S)
        if step % 10 == 0:
            yield fleet.truth()[4]


def test_a_px4_without_gps_flies_on_the_ranges_that_it_is_handed():
    scenario, settings = px4_alone((1, 2, 3, 4))
    truths = aided(scenario, settings, 60.0)
    assert np.sqrt(np.mean(np.square(autopilot_errors_m(truths, 30.0)))) < 3.0
    assert truths[-1].source == "ranging beacons"
    assert truths[-1].aid_refusal is None


def test_even_one_station_helps():
    scenario, settings = px4_alone((3,))
    with_it, without = aided(scenario, settings, 80.0), alone(scenario, 80.0)
    assert np.mean(autopilot_errors_m(with_it, 30.0)) < 0.7 * np.mean(autopilot_errors_m(without, 30.0))


def test_behind_a_shared_radio_no_range_is_sent_for_every_px4_takes_it():
    engine = Engine(load_estimator("fleet", {}), EngineSettings(aiding=AidingSettings(method="ranging_beacon")))
    engine.receive(Heartbeat(4, 0.0, Autopilot.PX4, True, winged=False))
    engine.receive(RouteReport(4, 0.0, RouteBlock.SHARED_ADDRESS, (5,)))
    engine.poll(0.5)
    (view,) = engine.snapshot(0.5).vehicles
    assert view.inhibit_reason is not None


def test_an_ardupilot_is_told_that_the_method_is_not_for_it():
    engine = Engine(load_estimator("fleet", {}), EngineSettings(aiding=AidingSettings(method="ranging_beacon")))
    engine.receive(Heartbeat(4, 0.0, Autopilot.ARDUPILOT, True, winged=False))
    engine.receive(RouteReport(4, 0.0, None))
    engine.poll(0.5)
    (view,) = engine.snapshot(0.5).vehicles
    assert view.inhibit_reason is not None
    assert "PX4 alone" in view.inhibit_reason
