"""Faults on cue, and the noise of sensors and links."""

from __future__ import annotations

import math
import struct
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from sitl_fakes.faults import GpsLost
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import Ranging, ScenarioError
from sitl_fakes.sensors import GaussMarkov, Ranger
from tests.unit.sitl_fakes.fakes_support import EXACT, parse, scenario

PEER_RANGE = (181600).to_bytes(3, "little")


def fault(kind, at_s=5.0, **more):
    return {"kind": kind, "vehicle": 1, "at_s": at_s, **more}


def receiver_error(fleet, message):
    """East and north error (m) of a GPS_RAW_INT against the truth now."""
    truth = fleet.truth()[1]
    east, north, _ = fleet.frame.to_enu(message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
    return east - truth.east_m, north - truth.north_m


def last_raw(fleet, at_s):
    return parse(fleet.advance(at_s), "GPS_RAW_INT", 1)[-1]


def ranges(datagrams):
    return [struct.unpack("<QffHBBB", d.payload[10:-2].ljust(21, b"\0"))[1] for d in datagrams if d.payload[7:10] == PEER_RANGE]


def test_a_lost_fix_comes_back_when_the_fault_ends():
    fleet = Fleet(scenario(fault=[fault("gps_lost", until_s=8.0)]), 1)
    assert last_raw(fleet, 4.9).fix_type == 6
    assert last_raw(fleet, 7.0).fix_type == 1
    assert last_raw(fleet, 9.0).fix_type == 6
    assert fleet.truth()[1].source == "gps1"


def test_a_frozen_receiver_repeats_its_last_fix_as_new():
    fleet = Fleet(scenario(fault=[fault("gps_frozen")]), 1)
    fleet.advance(5.2)
    messages = parse(fleet.advance(10.0), "GPS_RAW_INT", 1)
    assert len({(m.lat, m.lon) for m in messages}) == 1
    assert len({m.time_usec for m in messages}) == len(messages)
    assert {m.fix_type for m in messages} == {6}


def test_a_spoofer_walks_the_fix_away_and_the_autopilot_with_it():
    fleet = Fleet(scenario(fault=[fault("gps_spoofed", direction_deg=90.0, speed_mps=2.0)]), 1)
    raw = last_raw(fleet, 45.0)
    # 40 s at 2 m/s; the autopilot steers back onto its route by the error, so the truth moves off it by the same.
    assert receiver_error(fleet, raw)[0] == pytest.approx(80.0, abs=3.0)
    truth = fleet.truth()[1]
    assert truth.estimate_east_m - truth.east_m == pytest.approx(80.0, abs=8.0)
    assert truth.off_route_m > 50.0
    assert raw.fix_type == 6


def test_a_spoofed_step_is_refused_at_first():
    fleet = Fleet(scenario(fault=[fault("gps_spoofed", speed_mps=0.0, offset_m=334.0)]), 1)
    out = fleet.advance(8.0)
    truth = fleet.truth()[1]
    assert abs(truth.estimate_east_m - truth.east_m) < 20.0
    assert parse(out, "EKF_STATUS_REPORT", 1)[-1].flags & 32768
    fleet.advance(18.0)
    truth = fleet.truth()[1]
    assert truth.estimate_east_m - truth.east_m == pytest.approx(334.0, abs=40.0)


def test_a_jammed_receiver_flickers_and_wanders():
    fleet = Fleet(scenario(fault=[fault("gps_jammed")]), 1)
    messages = parse(fleet.advance(65.0), "GPS_RAW_INT", 1)
    kinds = [m.fix_type for m in messages if m.time_usec]
    assert sum(a != b for a, b in pairwise(kinds)) > 10
    assert max(m.h_acc for m in messages) > 100_000
    assert math.hypot(*receiver_error(fleet, messages[-1])) > 20.0


def test_range_faults_drop_bias_and_stick():
    def flight(*faults):
        fleet = Fleet(scenario(ranging={"sigma_m": 0.1}, fault=list(faults)), 1)
        fleet.advance(5.0)
        return ranges(fleet.advance(8.0))

    clean = flight()
    assert len(clean) == 30
    assert flight(fault("range_dropout")) == []
    assert flight(fault("range_dropout", peer=2)) == []
    biased = flight(fault("range_bias", bias_m=50.0))
    assert np.allclose(np.subtract(biased, clean), 50.0, atol=0.01)
    assert len(set(flight(fault("range_stuck", at_s=4.0)))) == 1


def test_a_dead_link_is_dead_in_both_directions_and_only_for_its_vehicle():
    fleet = Fleet(scenario(fault=[fault("link_dropout", until_s=10.0)]), 1)
    fleet.advance(5.0)
    silent = fleet.advance(9.9)
    assert {d.sysid for d in silent} == {2}
    assert {d.sysid for d in fleet.advance(11.0)} == {1, 2}


def test_a_rebooted_vehicle_is_silent_starts_its_clock_anew_and_finds_its_position_again():
    fleet = Fleet(scenario(fault=[fault("reboot")]), 1)
    before = fleet.advance(4.98)
    assert {d.sysid for d in fleet.advance(9.9)} == {2}
    after = parse(fleet.advance(20.0), "SYSTEM_TIME", 1)
    assert parse(before, "SYSTEM_TIME", 1)[-1].time_boot_ms > 10_000
    assert after[0].time_boot_ms == pytest.approx(5500, abs=600)
    assert fleet.truth()[1].source == "gps1"
    assert fleet.truth()[1].off_route_m < 15.0


@pytest.mark.parametrize("by_s", [40.0, -7.0])
def test_a_clock_that_jumps_does_so_once_and_nothing_else_changes(by_s):
    fleet, even = Fleet(scenario(fault=[fault("clock_jump", by_s=by_s)]), 1), Fleet(scenario(), 1)
    stamps, steady = (parse(f.advance(20.0), "GLOBAL_POSITION_INT", 1) for f in (fleet, even))
    steps = [(a.time_boot_ms - b.time_boot_ms) / 1e3 for a, b in zip(stamps, steady, strict=True)]
    assert {round(step, 2) for step in steps} == {0.0, by_s}
    assert [m.lat for m in stamps] == [m.lat for m in steady]


def test_a_vehicle_rebooted_without_gps_has_no_position_and_says_so():
    fleet = Fleet(scenario(fault=[fault("gps_lost"), fault("reboot", at_s=8.0)]), 1)
    out = fleet.advance(20.0)
    assert fleet.truth()[1].source == "none"
    position, ekf = parse(out, "GLOBAL_POSITION_INT", 1)[-1], parse(out, "EKF_STATUS_REPORT", 1)[-1]
    assert (position.lat, position.lon) == (0, 0)
    assert position.alt == pytest.approx(600_000, abs=3000)
    assert not ekf.flags & 16
    assert ekf.flags & 128
    assert parse(out, "SYSTEM_TIME", 1)[-1].time_unix_usec == 0


def test_faults_can_be_injected_in_process_and_only_on_vehicles_that_exist():
    fleet = Fleet(scenario(), 1)
    fleet.advance(1.0)
    fleet.inject(GpsLost(vehicle=2, at_s=1.0))
    assert parse(fleet.advance(2.0), "GPS_RAW_INT", 2)[-1].fix_type == 1
    with pytest.raises(ScenarioError, match="no vehicle 9"):
        fleet.inject(GpsLost(vehicle=9, at_s=1.0))


def test_time_correlated_gps_noise_has_its_sigma_and_its_memory():
    """50,000 s of a 60 s process hold some 400 independent draws: sigma to 4 %, checked to four of those."""
    process = GaussMarkov(np.random.default_rng(1), 1.5, 60.0, 2)
    samples = np.array([process.advance(1.0) for _ in range(50_000)])
    assert samples.std() == pytest.approx(1.5, rel=0.16)
    lag = np.mean(samples[:-60] * samples[60:]) / np.mean(samples**2)
    assert lag == pytest.approx(math.exp(-1.0), abs=0.15)
    white = GaussMarkov(np.random.default_rng(1), 1.5, 0.0, 1)
    values = np.array([white.advance(0.1)[0] for _ in range(5000)])
    assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 0.06


def test_range_noise_outliers_loss_and_reach_are_as_set():
    """4,000 draws. Bands of four standard errors."""
    settings = Ranging(rate_hz=50.0, sigma_m=1.0, outlier_share=0.1, outlier_min_m=20.0, outlier_max_m=40.0, loss=0.2)
    ranger = Ranger(settings, 1, [2, 3], seed=5)
    places = {2: (300.0, 400.0, 0.0), 3: (0.0, 0.0, 2e5)}
    samples = [s for k in range(4000) for s in ranger.measure(k * 0.02, (0.0, 0.0, 0.0), places, [])]
    assert {s.peer for s in samples} == {2}
    errors = np.array([s.range_m for s in samples]) - 500.0
    assert len(samples) == pytest.approx(3200, abs=101)
    outliers = errors[errors > 10.0]
    assert len(outliers) / len(errors) == pytest.approx(0.1, abs=0.021)
    assert outliers.min() > 15.0
    assert outliers.max() < 45.0
    assert errors[errors < 10.0].std() == pytest.approx(1.0, abs=0.05)
    lost = np.diff([s.sequence for s in samples])
    assert lost.sum() == samples[-1].sequence - samples[0].sequence
    assert lost.max() > 1


def test_both_ends_of_a_pair_have_the_same_bias():
    settings = Ranging(sigma_m=1e-6, bias_sigma_m=2.0)
    places = {1: (0.0, 0.0, 0.0), 2: (100.0, 0.0, 0.0)}
    there = Ranger(settings, 1, [2], 9).measure(0.0, places[1], places, [])[0].range_m - 100.0
    back = Ranger(settings, 2, [1], 9).measure(0.0, places[2], places, [])[0].range_m - 100.0
    assert there == pytest.approx(back, abs=1e-4)
    assert abs(there) > 1e-3


def test_a_link_delays_jitters_reorders_and_loses():
    telemetry = {"latency_s": 0.05, "jitter_s": 0.3, "loss": 0.1}
    clear, poor = Fleet(scenario(), 1), Fleet(scenario(telemetry=telemetry), 1)
    sent = clear.advance(32.0)
    came = [d for k in range(1, 301) for d in poor.advance(0.1 * k)] + [d for d in poor.advance(31.0) if d.due_s < 30.35]
    times_sent = Counter(d.payload for d in sent)
    sent_at = {d.payload: d.due_s for d in sent if times_sent[d.payload] == 1 and d.due_s <= 30.0}
    delays = np.array([d.due_s - sent_at[d.payload] for d in came if d.payload in sent_at])
    assert len(delays) / len(sent_at) == pytest.approx(0.9, abs=0.03)
    assert delays.min() >= 0.05 - 1e-9
    assert delays.max() <= 0.35 + 1e-9
    assert delays.mean() == pytest.approx(0.2, abs=0.02)
    order = [sent_at[d.payload] for d in came if d.payload in sent_at]
    assert any(a > b for a, b in pairwise(order))
    assert [d.due_s for d in came] == sorted(d.due_s for d in came)


def test_an_aircraft_without_sensor_errors_holds_its_altitude_over_the_curved_earth():
    vehicles = [{"sysid": 1, "waypoints": [[0, 15000], [0, 30000]], "height_m": 150.0}]
    fleet = Fleet(scenario(vehicle=vehicles, dead_reckoning=EXACT), 1)
    fleet.advance(120.0)
    truth = fleet.truth()[1]
    assert truth.alt_msl_m == pytest.approx(650.0, abs=0.5)
    assert truth.up_m < 150.0 - truth.north_m**2 / (2.0 * 6.4e6) * 0.98
