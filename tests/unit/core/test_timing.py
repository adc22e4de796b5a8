"""A sender's clock from one-way stamps: latency, drift, jumps and reboots."""

import numpy as np
import pytest

from gcs_coloc.core.timing import SenderClock


def test_jittered_latency_drops_out_but_for_the_least_delay():
    clock = SenderClock()
    rng = np.random.default_rng(3)
    for stamp in np.arange(0.0, 30.0, 0.1):
        assert clock.learn(stamp, 1000.0 + stamp + 0.05 + rng.uniform(0.0, 0.35))
    # 300 draws of a uniform delay: the least exceeds 50 ms by more than 10 ms once in (1 - 10/350)^300 = 2e-4.
    assert clock.to_service(30.0) == pytest.approx(1030.05, abs=0.01)


def test_a_slow_clock_is_followed():
    clock = SenderClock()
    for arrival in np.arange(0.0, 3600.0, 0.5):
        clock.learn(arrival * (1 - 20e-6), arrival)
    assert clock.to_service(3600.0 * (1 - 20e-6)) == pytest.approx(3600.0, abs=0.002)


def test_a_single_jump_is_refused_and_changes_nothing():
    clock = SenderClock()
    for stamp in range(10):
        clock.learn(float(stamp), 100.0 + stamp)
    assert not clock.learn(4000.0, 110.0)
    assert not clock.learn(1.0, 111.0)
    assert clock.learn(12.0, 112.0)
    assert clock.to_service(12.0) == 112.0
    assert clock.resets == 0


def test_a_reboot_is_believed_with_the_third_message():
    clock = SenderClock()
    for stamp in range(500, 510):
        clock.learn(float(stamp), float(stamp))
    assert [clock.learn(1.0 + i, 520.0 + i) for i in range(4)] == [False, False, True, True]
    assert clock.resets == 1
    assert clock.to_service(5.0) == 524.0


def test_the_wrap_of_the_32_bit_millisecond_clock_is_no_reboot():
    clock = SenderClock()
    wrap = 2**32 / 1e3
    for i in range(20):
        assert clock.learn((wrap - 5.0 + i) % wrap, float(i))
        assert clock.to_service((wrap - 5.0 + i) % wrap) == pytest.approx(i, abs=1e-6)
    assert clock.resets == 0
    assert clock.to_service((wrap - 5.0 + 4.0) % wrap) == pytest.approx(4.0, abs=1e-6)  # late, from before the wrap


def test_drift_is_measured_where_the_stamps_show_it_and_is_a_crystals_otherwise():
    rng = np.random.default_rng(5)
    fast = SenderClock()
    assert fast.drift.sigma == 20e-6
    for at_s in np.arange(0.0, 300.0, 0.05):
        fast.learn(at_s * (1 + 40e-6), at_s + rng.uniform(0.05, 0.4))
    # The least of 200 delays in each bucket of 10 s scatters by 1.75 ms; 29 of them over 290 s give 4e-6.
    assert fast.drift.rate == pytest.approx(-40e-6, abs=4 * 4e-6)
    assert fast.drift.sigma < 6e-6


def test_a_reboot_during_a_long_silence_begins_a_new_clock_at_once():
    clock = SenderClock()
    for stamp in range(1000, 1010):
        clock.learn(float(stamp), float(stamp))
    assert [clock.learn(5.0 + i, 1500.0 + i) for i in range(4)] == [True] * 4
    assert clock.to_service(8.0) == 1503.0


def test_late_messages_within_two_seconds_are_no_jump():
    clock = SenderClock()
    clock.learn(10.0, 10.0)
    assert clock.learn(8.5, 10.1)
    assert clock.to_service(8.5) == 8.5


def test_after_a_long_silence_the_old_offset_is_forgotten():
    clock = SenderClock()
    clock.learn(0.0, 0.0)
    clock.learn(1000.0, 1000.5)
    assert clock.to_service(1000.0) == 1000.5
