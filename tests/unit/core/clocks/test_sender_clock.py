"""A sender's clock from one-way stamps: latency, drift, jumps and reboots."""

import numpy as np
import pytest

from gcs_coloc.core.clocks.sender_clock import SenderClock


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


RATE_HZ = 20.0


def heard(delays_s, start_s=0.0):
    """Arrivals with stamps, in the order of arrival, of messages that are under way for these delays."""
    sent_s = start_s + np.arange(len(delays_s)) / RATE_HZ
    return sorted((float(at_s + delay_s), float(at_s)) for at_s, delay_s in zip(sent_s, delays_s, strict=True))


def queued(rng, count):
    """Delays of a link that stands still now and then for up to 5 s and then delivers all at once, in order."""
    sent_s = np.arange(count) / RATE_HZ
    arrival_s = sent_s + rng.uniform(0.05, 0.07, count)
    for begin_s in rng.uniform(0.0, sent_s[-1], count // 400):
        stop_s = begin_s + rng.uniform(0.2, 5.0)
        held = (arrival_s >= begin_s) & (arrival_s < stop_s)
        arrival_s[held] = stop_s
    return np.maximum.accumulate(arrival_s) + 1e-6 * np.arange(count) - sent_s


LINKS = {
    "50 to 400 ms, overtaking": lambda rng, count: rng.uniform(0.05, 0.4, count),
    "an exponential tail, overtaking": lambda rng, count: np.minimum(0.05 + rng.exponential(0.1, count), 1.0),
    "two paths, 50 and 450 ms": lambda rng, count: np.where(rng.random(count) < 0.5, 0.05, 0.45) + rng.uniform(0.0, 0.02, count),
    "stands still and catches up": queued,
}


@pytest.mark.parametrize("link", LINKS)
def test_no_delay_of_a_link_is_taken_for_a_jump(link):
    for seed in range(5):
        clock, rng = SenderClock(), np.random.default_rng(seed)
        refused = sum(not clock.learn(stamp_s, arrival_s) for arrival_s, stamp_s in heard(LINKS[link](rng, 6000)))
        assert clock.resets == 0
        assert refused <= 6  # of 6000: single ones from far behind, before it is known how far


@pytest.mark.parametrize("link", ["50 to 400 ms, overtaking", "two paths, 50 and 450 ms", "stands still and catches up"])
def test_a_step_back_by_a_second_is_noticed_by_its_stamps_where_messages_do_not_overtake_each_other_by_as_much(link):
    noticed_after_s = []
    for seed in range(9):
        clock, rng = SenderClock(), np.random.default_rng(seed)
        for arrival_s, stamp_s in heard(LINKS[link](rng, 1200)):
            clock.learn(stamp_s, arrival_s)
        before = clock.resets
        noticed_after_s.append(float("inf"))
        for arrival_s, stamp_s in heard(LINKS[link](rng, 200), start_s=60.0):
            clock.learn(stamp_s - 1.0, arrival_s)
            if clock.resets > before and noticed_after_s[-1] == float("inf"):
                noticed_after_s[-1] = arrival_s - 60.0
        assert clock.resets <= before + 1
    assert max(noticed_after_s) < 0.8


def test_after_a_long_silence_the_old_offset_is_forgotten():
    clock = SenderClock()
    clock.learn(0.0, 0.0)
    clock.learn(1000.0, 1000.5)
    assert clock.to_service(1000.0) == 1000.5


@pytest.mark.parametrize("rate", [0.0, 0.001, 0.5])
def test_a_stamp_that_stands_still_or_crawls_is_not_followed_as_a_clock(rate):
    """Senders that leave time_boot_ms at 0, or count seconds in it: what bears such a stamp must not be taken for fresh."""
    clock = SenderClock()
    arrivals = np.arange(0.0, 600.0, 0.1)
    ages_s = [t - clock.to_service(rate * t) for t in arrivals if clock.learn(rate * t, t)]
    assert min(ages_s[200:]) > 5.0


def test_a_simulation_that_runs_slow_by_a_per_cent_is_followed():
    clock = SenderClock()
    for arrival in np.arange(0.0, 600.0, 0.1):
        assert clock.learn(0.99 * arrival, arrival)
    assert clock.to_service(0.99 * 600.0) == pytest.approx(600.0, abs=0.15)


def test_the_mean_wait_is_of_all_stamps_and_not_of_the_first_ones_of_ten_seconds():
    clock = SenderClock()
    for n in range(32):
        clock.learn(0.2 * n, 0.2 * n + (0.0 if n == 0 else 0.3))
        clock.mean_wait_s()
    assert clock.mean_wait_s() == pytest.approx(0.3, abs=0.02)
