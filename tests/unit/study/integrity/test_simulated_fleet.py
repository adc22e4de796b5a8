"""What flies in the trials: motion that a vehicle can fly, errors as they are stated, faults where they are drawn."""

from dataclasses import replace
from itertools import pairwise
from math import dist, inf, radians

import numpy as np
import pytest

from gcs_coloc.core.messages.inbound import Airspeed, GlobalPosition, GpsReceiver, PeerRange
from gcs_coloc.core.messages.outbound import GpsInput, TimeSyncRequest
from gcs_coloc.study.integrity.flight_classes import CLASSES, RangeNoise
from gcs_coloc.study.integrity.motion import STEP_S, draw_trajectories, gauss_markov
from gcs_coloc.study.integrity.sensor_errors import BarometerJump, PairErrors, PitotFailure, PitotFault
from gcs_coloc.study.integrity.simulated_fleet import DENIED, SimulatedFleet
from gcs_coloc.study.integrity.simulated_vehicle import UNIX_EPOCH_S

MINUTE_S = 60.0


def messages(fleet, until_s):
    found = []
    while True:
        at_s, message = fleet.pop()
        if at_s > until_s:
            return found
        if message is not None:
            assert message.received_at_s == at_s
            found.append(message)


def fleet_of(name, seed=1, duration_s=MINUTE_S, **changes):
    return SimulatedFleet(replace(CLASSES[name], **changes), seed, duration_s)


def test_there_are_at_least_thirty_classes_of_four_groups():
    assert len(CLASSES) >= 30
    assert len({drawn.group for drawn in CLASSES.values()}) == 4
    assert all(drawn.text for drawn in CLASSES.values())


@pytest.mark.parametrize("name", CLASSES)
def test_every_class_flies_and_its_messages_arrive_in_order(name):
    fleet = fleet_of(name, duration_s=20.0)
    found = messages(fleet, 6.0)
    times = [message.received_at_s for message in found]
    assert times == sorted(times)
    assert {type(message) for message in found} >= {GpsReceiver, GlobalPosition, PeerRange}


@pytest.mark.parametrize("name", ["planes", "copters", "agile-copters", "convoy"])
def test_velocity_is_the_rate_of_the_position(name):
    for course in draw_trajectories(np.random.default_rng(3), CLASSES[name], MINUTE_S, 5):
        rate = np.diff(course.positions_m, axis=0) / STEP_S
        mean = 0.5 * (course.velocities_mps[1:] + course.velocities_mps[:-1])
        # Gusts and the swaying of a convoy are new at each step.
        assert np.abs(rate - mean)[100:-100].max() < 0.6


def test_a_plane_turns_as_its_bank_tells():
    drawn = replace(CLASSES["planes"], wind_mps=(0.0, 0.0), gust_mps=(0.0, 0.0))
    course = draw_trajectories(np.random.default_rng(5), drawn, MINUTE_S, 5)[0]
    roll, yaw = course.attitude_rad[:-1, 0], course.attitude_rad[:, 2]
    turn = np.angle(np.exp(1j * np.diff(yaw))) / STEP_S
    assert np.allclose(turn, 9.80665 * np.tan(roll) / np.median(course.airspeed_mps), atol=1e-6)
    assert np.abs(roll).max() > radians(5.0)


def test_a_copter_keeps_its_acceleration():
    drawn = replace(CLASSES["agile-copters"], acceleration_mps2=(6.0, 6.0))
    course = draw_trajectories(np.random.default_rng(5), drawn, MINUTE_S, 5)[0]
    acceleration = np.linalg.norm(np.diff(course.velocities_mps, axis=0), axis=1) / STEP_S
    assert 4.0 < acceleration.max() <= 6.01


@pytest.mark.parametrize("seed", [5, 6])
def test_a_copter_tilts_as_its_acceleration_and_the_air_ask(seed):
    drawn = replace(CLASSES["agile-copters"], wind_mps=(6.0, 6.0), gust_mps=(0.0, 0.0))
    course = draw_trajectories(np.random.default_rng(seed), drawn, MINUTE_S, 5)[0]
    roll, pitch, yaw = course.attitude_rad[1:].T
    acceleration = np.diff(course.velocities_mps, axis=0) / STEP_S
    thrust = 9.80665 + acceleration[:, 2]
    forward, right = -thrust * np.tan(pitch), thrust * np.tan(roll) / np.cos(pitch)
    force = np.concatenate([forward * np.sin(yaw) + right * np.cos(yaw), forward * np.cos(yaw) - right * np.sin(yaw)])
    east, north = np.repeat(np.eye(2), len(yaw), axis=1)
    causes = np.stack([acceleration[:, :2].T.ravel(), course.velocities_mps[1:, :2].T.ravel(), east, north], axis=1)
    (gain, drag_per_s, *still), *_ = np.linalg.lstsq(causes, force, rcond=None)
    assert gain == pytest.approx(1.0, abs=0.05)
    assert 0.1 <= drag_per_s <= 0.5
    # Where it stands still the wind alone tilts it, and the error of its trim.
    assert np.hypot(*still) == pytest.approx(6.0 * drag_per_s, abs=0.6)
    assert np.std(force - causes @ (gain, drag_per_s, *still)) < 0.2 * np.std(force)


def test_gauss_markov_keeps_its_sigma_and_time():
    values = gauss_markov(np.random.default_rng(1), 200_000, 1.0, 2.0, 30.0, axes=1)[:, 0]
    assert values.std() == pytest.approx(2.0, rel=0.05)
    assert np.corrcoef(values[:-30], values[30:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.05)


@pytest.mark.parametrize("noise", [RangeNoise.GAUSS, RangeNoise.STUDENT])
def test_range_noise_has_the_stated_sigma(noise):
    drawn = replace(CLASSES["planes"], range_noise=noise, range_loss=(0.0, 0.0))
    errors = PairErrors(np.random.default_rng(2), drawn, 1.5, device_m=0.0, scale=0.0, end_s=MINUTE_S)
    sample = np.array([errors.measure(1000.0, 1.0) for _ in range(40_000)]) - 1000.0
    assert abs(np.median(sample)) < 0.03
    assert sample.std() == pytest.approx(1.5, rel=0.1)


def test_the_denied_vehicle_loses_its_fix_and_reports_the_one_that_it_is_sent():
    fleet = fleet_of("planes", lost_at_s=(5.0, 5.0))
    place = fleet.frame.to_lla(300.0, 400.0, 100.0)
    found = messages(fleet, 8.0)
    fixes = {m.fix_type for m in found if isinstance(m, GpsReceiver) and m.sysid == DENIED and m.received_at_s > 6.0}
    assert fixes == {1}
    fleet.deliver(GpsInput(DENIED, 1, 0, 0, 0, 3, *place, 1.0, 1.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 12), 8.0)
    later = messages(fleet, 9.0)
    echoed = [m for m in later if isinstance(m, GlobalPosition) and m.sysid == DENIED]
    east, north, _ = fleet.frame.to_enu(echoed[-1].lat_deg, echoed[-1].lon_deg, echoed[-1].alt_msl_m)
    assert (east, north) == pytest.approx((300.0, 400.0), abs=0.1)
    assert any(isinstance(m, GpsReceiver) and m.receiver == 1 and m.fix_type == 3 for m in later)


def test_receivers_that_are_spoofed_alike_are_off_alike():
    fleet = fleet_of("two-alike-step", duration_s=200.0)
    spoofed = fleet.spoofed()
    assert len(spoofed) == 2
    fixes = [m for m in messages(fleet, 199.0) if isinstance(m, GpsReceiver) and m.sysid in spoofed]
    offsets = []
    for sysid in spoofed:
        late = [m for m in fixes if m.sysid == sysid and m.received_at_s > fleet.fault_at_s + 1.0]
        off = [
            np.array(fleet.frame.to_enu(m.lat_deg, m.lon_deg, m.alt_msl_m)) - fleet.truth_m(sysid, m.received_at_s) for m in late
        ]
        offsets.append(np.mean(off, axis=0)[:2])
    assert np.linalg.norm(offsets[0]) > 25.0
    assert np.linalg.norm(offsets[0] - offsets[1]) < 6.0


def test_timesync_is_answered_in_classes_that_do():
    for name, answers in (("planes", 1), ("late-alike", 0)):
        fleet = fleet_of(name)
        fleet.deliver(TimeSyncRequest(1, 123), 1.0)
        found = [m for m in messages(fleet, 4.0) if type(m).__name__ == "TimeSyncAnswer"]
        assert [m.ts1_ns for m in found] == [123] * answers


def test_what_waits_for_the_service_is_received_at_its_start():
    times = [message.received_at_s for message in messages(fleet_of("started-in-flight"), 3.0)]
    assert min(times) == 0.5
    assert times.count(0.5) > 20


def test_a_pitot_tube_that_fails_is_stuck_or_reads_a_constant_or_a_multiple():
    drawn = [PitotFailure.draw(np.random.default_rng(seed), 10.0) for seed in range(30)]
    assert {each.fault for each in drawn} == set(PitotFault)
    for each in drawn:
        assert each.reads_mps(21.0, 9.9) == 21.0
        first, later = each.reads_mps(20.0, 10.0), each.reads_mps(30.0, 11.0)
        if each.fault is PitotFault.FACTOR:
            assert (first, later) == pytest.approx((20.0 * each.factor, 30.0 * each.factor))
        else:
            assert first == later
            assert (first == 20.0) == (each.fault is PitotFault.STUCK)


def test_only_the_denied_vehicles_pitot_tube_fails_and_after_the_loss():
    """Seed 4 draws one that reads 69 m/s."""
    fleet, seen = SimulatedFleet(CLASSES["pitot"], 4, 60.0), []
    while (event := fleet.pop())[0] <= 60.0:
        if isinstance(event[1], Airspeed):
            seen.append(event[1])
    fast = [m for m in seen if m.airspeed_mps > 60.0]
    assert {m.sysid for m in fast} == {DENIED}
    assert min(m.received_at_s for m in fast) == pytest.approx(fleet.fault_at_s, abs=0.5)
    assert fleet.fault_at_s > fleet.lost_at_s


def test_a_barometer_jumps_up_or_down_and_half_of_them_back():
    drawn = [BarometerJump.draw(np.random.default_rng(seed), 10.0, (5.0, 60.0)) for seed in range(30)]
    assert {each.jump_m > 0.0 for each in drawn} == {True, False}
    assert 10 <= sum(each.until_s < inf for each in drawn) <= 20
    for each in drawn:
        assert 5.0 <= abs(each.jump_m) <= 60.0
        assert [each.offset_m(at_s) for at_s in (9.9, 10.0, each.until_s)] == [0.0, each.jump_m, 0.0]


def test_only_the_denied_vehicles_barometer_jumps_and_after_the_loss():
    """Its height is its barometer's; those of its peers are their receivers'."""
    fleet, before, after = SimulatedFleet(CLASSES["barometer"], 4, 120.0), {}, {}
    while (event := fleet.pop())[0] <= fleet.fault_at_s + 1.0:
        if isinstance(m := event[1], GlobalPosition):
            (before if event[0] < fleet.fault_at_s else after)[m.sysid] = m.alt_msl_m
    jumped = {sysid for sysid, alt_m in after.items() if abs(alt_m - before[sysid]) > 4.0}
    assert jumped == {DENIED}
    assert fleet.fault_at_s > fleet.lost_at_s


def longest_silence(found, sysid):
    """When the longest silence of a vehicle after the loss begins and ends, s."""
    heard_s = [m.received_at_s for m in found if isinstance(m, GlobalPosition) and m.sysid == sysid]
    return max(pairwise([60.0, *heard_s]), key=lambda pair: pair[1] - pair[0])


@pytest.fixture(scope="module")
def blacked_out():
    """What is heard of a fleet whose vehicles are without radio now and then."""
    return messages(fleet_of("blackouts", seed=2, duration_s=200.0), 190.0)


def test_a_peer_without_radio_is_ranged_on(blacked_out):
    begins_s, ends_s = longest_silence(blacked_out, 1)
    assert 3.0 < ends_s - begins_s < 30.0
    ranged_s = [m.received_at_s for m in blacked_out if isinstance(m, PeerRange) and (m.sysid, m.peer) == (DENIED, 1)]
    assert sum(begins_s + 0.5 < at_s < ends_s - 0.5 for at_s in ranged_s) > 5


def test_what_is_sent_to_a_vehicle_without_radio_is_lost(blacked_out):
    _, ends_s = longest_silence(blacked_out, DENIED)
    for sent_s, is_taken in ((ends_s - 0.5, False), (ends_s, True)):
        fleet = fleet_of("blackouts", seed=2, duration_s=200.0)
        messages(fleet, sent_s)
        fleet.deliver(GpsInput(DENIED, 1, 0, 0, 0, 3, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 12), sent_s)
        later = messages(fleet, ends_s + 2.0)
        assert any(isinstance(m, GpsReceiver) and m.receiver == 1 and m.fix_type == 3 for m in later) == is_taken


def test_only_the_denied_vehicles_companion_clock_is_set_back_and_after_the_loss():
    fleet = SimulatedFleet(CLASSES["set-back-clock"], 1, 120.0)
    least_s: dict[bool, float] = {}
    for message in messages(fleet, fleet.fault_at_s + 5.0):
        if isinstance(message, PeerRange):
            is_set_back = message.sysid in fleet.denied and message.received_at_s > fleet.fault_at_s + 1.0
            late_s = message.received_at_s - (message.measured_at_s - UNIX_EPOCH_S)
            least_s[is_set_back] = min(least_s.get(is_set_back, inf), late_s)
    assert fleet.fault_at_s > fleet.lost_at_s
    assert 0.15 < least_s[True] - least_s[False] < 0.55


def test_the_ranges_of_one_pair_of_the_denied_vehicle_are_too_long():
    fleet = fleet_of("pair-detour", delay_s=(0.0, 0.0), jitter_s=(0.001, 0.001))
    longer_m: dict[tuple[int, int], list[float]] = {}
    for message in messages(fleet, 10.0):
        if isinstance(message, PeerRange):
            ends = [fleet.truth_m(sysid, message.received_at_s) for sysid in (message.sysid, message.peer)]
            longer_m.setdefault((message.sysid, message.peer), []).append(message.range_m - dist(*ends))
    off = {pair for pair, values in longer_m.items() if np.median(values) > 5.0}
    assert [pair[0] for pair in off] == [DENIED]


def test_doppler_velocity_is_that_of_the_course_or_of_the_false_track():
    def drift_mps(fleet):
        """What the fixes of the spoofed receiver move by other than its velocity, in ten seconds of the fault."""
        (sysid,) = fleet.spoofed()
        fixes = [m for m in messages(fleet, fleet.fault_at_s + 12.0) if isinstance(m, GpsReceiver) and m.sysid == sysid]
        fixes = [m for m in fixes if m.received_at_s > fleet.fault_at_s + 2.0 and m.receiver == 0]
        places = [fleet.frame.to_enu(m.lat_deg, m.lon_deg, m.alt_msl_m) for m in fixes]
        moved = [0.0, 0.0]
        for last, fix in pairwise(fixes):
            for axis, mps in enumerate(reversed(fix.velocity_ne_mps)):
                moved[axis] += mps * (fix.fixed_boot_s - last.fixed_boot_s)
        passed_s = fixes[-1].fixed_boot_s - fixes[0].fixed_boot_s
        return dist(moved, [places[-1][axis] - places[0][axis] for axis in (0, 1)]) / passed_s

    spoofing = replace(CLASSES["spoofed-ramp"].spoofing, ramp_mps=(4.0, 4.0))
    drifts = [drift_mps(fleet_of("spoofed-ramp", seed, 120.0, spoofing=spoofing)) for seed in range(8)]
    assert {round(drift / 4.0) for drift in drifts} == {0, 1}
