"""A position that jumps other than the vehicle moves is as uncertain as the jump was, until the filter behind it has settled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from built_measurements import Builder, gps, position, vehicle

from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.core.telemetry.position_builder import PositionJumps, receiver_accuracy

SPEED_MPS = 21.0
STATED_M = 0.5


def report(at_s: float, off_m: tuple[float, float] = (0.0, 0.0), rate_radps: float = 0.0, sigma_m: float = STATED_M):
    """A plane at `at_s` of its circle, or of its straight way, reported `off_m` beside where it is."""
    if rate_radps:
        radius_m, angle = SPEED_MPS / rate_radps, rate_radps * at_s
        east, north = radius_m * math.sin(angle), -radius_m * math.cos(angle)
    else:
        east, north, angle = SPEED_MPS * at_s, 0.0, 0.0
    velocity = (SPEED_MPS * math.cos(angle), SPEED_MPS * math.sin(angle), 0.0)
    return PositionMeasurement(4, at_s, at_s, (east + off_m[0], north + off_m[1], 50.0), sigma_m, 1.0, velocity, 0.3)


def test_a_filter_that_was_set_to_another_receiver_is_as_uncertain_as_it_jumped_until_it_has_settled():
    """As seen on ArduPlane: right before GPS_PRIMARY was restored, 2.7 m off after it, and back with a time constant of 0.8 s."""
    jumps, rng = PositionJumps(), np.random.default_rng(1)
    for tenth in range(600):
        jumps.sigma_m(report(tenth / 10.0, tuple(rng.normal(0.0, 0.05, 2)), 0.2), is_trusted=True)
    for tenth in range(600, 700):
        off_m = 2.7 * math.exp(-(tenth - 600) / 8.0)
        stated_m = math.hypot(STATED_M, jumps.sigma_m(report(tenth / 10.0, (off_m, 0.0), 0.2), is_trusted=True))
        assert off_m < 2.45 * stated_m
    assert stated_m == STATED_M


def stated_after_a_jump(trusted_again_s: float) -> list[tuple[float, float]]:
    """A filter 4.5 m off from 60 to 64 s, once trusted again at a time: how far off it is, and what is stated, each tenth."""
    jumps, seen = PositionJumps(), []
    for tenth in range(800):
        at_s = tenth / 10.0
        off_m = 4.5 if 60.0 <= at_s < 64.0 else 0.0
        sigma_m = jumps.sigma_m(report(at_s, (off_m, 0.0), 0.2), is_trusted=at_s >= trusted_again_s)
        if at_s >= 60.0:
            seen.append((off_m, math.hypot(STATED_M, sigma_m)))
    return seen


def test_a_jump_of_a_vehicle_that_takes_its_own_receiver_again_is_held_for_seconds():
    """As seen on ArduPlane: 4.5 m off for 4 s once GPS_PRIMARY was restored, and back at once."""
    seen = stated_after_a_jump(trusted_again_s=59.9)
    assert all(off_m < 2.45 * stated_m for off_m, stated_m in seen)
    assert seen[-1][1] == STATED_M


def test_a_jump_long_after_is_soon_held_against_it():
    seen = stated_after_a_jump(trusted_again_s=45.0)
    assert [round(stated_m, 1) for _, stated_m in seen[:31:10]] == [4.5, 1.7, 0.8, 0.5]


@pytest.mark.parametrize("sigma_m", [0.5, 3.0])
@pytest.mark.parametrize("rate_hz", [1.0, 5.0])
def test_noise_alone_is_no_jump(sigma_m, rate_hz):
    """Positions of a receiver alone, with noise from report to report, for an hour: beyond four times the usual by e^-16 each."""
    jumps, rng = PositionJumps(), np.random.default_rng(2)
    added = [
        jumps.sigma_m(report(step / rate_hz, tuple(rng.normal(0.0, sigma_m, 2)), 0.2, sigma_m), is_trusted=True)
        for step in range(int(3600 * rate_hz))
    ]
    assert max(added) == 0.0


def test_a_large_step_does_not_blind_the_tests_of_a_faulty_receiver():
    jumps = PositionJumps()
    for tenth in range(100):
        jumps.sigma_m(report(tenth / 10.0), is_trusted=True)
    assert jumps.sigma_m(report(10.0, (200.0, 0.0)), is_trusted=True) == 10.0


def test_a_gap_or_a_report_of_the_past_is_no_jump():
    jumps = PositionJumps()
    for tenth in range(100):
        jumps.sigma_m(report(tenth / 10.0, rate_radps=0.5), is_trusted=True)
    assert jumps.sigma_m(report(20.0, rate_radps=0.5), is_trusted=True) == 0.0
    assert jumps.sigma_m(report(19.0, (50.0, 0.0), 0.5), is_trusted=True) == 0.0
    assert jumps.sigma_m(report(20.1, rate_radps=0.5), is_trusted=True) == 0.0


def test_what_is_measured_of_a_position_that_jumped_states_it():
    feed, healthy = Builder(has_frame=True), vehicle()
    healthy.receiver = gps(0.5, 0.5)
    hovers = replace(position(1.0), vn_mps=0.0, ve_mps=0.0)
    for second in range(60):
        before = feed.measure(replace(hovers, received_at_s=1.0 + second, boot_s=1.0 + second), healthy)
    jumped = feed.measure(replace(hovers, received_at_s=61.0, boot_s=61.0, lat_deg=hovers.lat_deg + 8.0 / 111_000.0), healthy)
    assert isinstance(before, PositionMeasurement)
    assert isinstance(jumped, PositionMeasurement)
    assert jumped.sigma_h_m > 5.0 > before.sigma_h_m


@pytest.mark.parametrize(("stated_mps", "taken_mps"), [(0.04, 0.1), (0.3, 0.3), (None, 0.5)])
def test_no_velocity_counts_as_better_than_a_filter_at_rest(stated_mps, taken_mps):
    """A rover that stood stated 0.09 m/s for minutes at 0.04 m/s; as a peer it drew another vehicle 3 m off."""
    accuracy = receiver_accuracy(replace(gps(0.5, 0.5), speed_acc_mps=stated_mps), MeasurementSettings())
    assert accuracy.sigma_velocity_mps == taken_mps
