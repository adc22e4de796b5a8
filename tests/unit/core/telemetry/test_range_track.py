"""A range that jumps is refused until it has come back; what vehicles can fly is no jump."""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np
import pytest

from gcs_coloc.core.telemetry.range_checks import RangeChecks, RangeTrack

STEP_S, SIGMA_M = 0.2, 1.0


def refused(true_m, *, off_m=lambda _t: 0.0, seed=1, until_s=120.0, speed_mps=20.0, sigma_m=SIGMA_M, noise_m=SIGMA_M):
    """Return the times at which ranges are refused."""
    rng, track = np.random.default_rng(seed), RangeTrack()
    times = [k * STEP_S for k in range(round(until_s / STEP_S))]
    return [t for t in times if track.add(t, true_m(t) + off_m(t) + noise_m * rng.normal(), sigma_m, speed_mps)]


def circling_m(t):
    """Range between two planes at 20 m/s that turn against each other at 37 degrees of bank."""
    a, b = t * 20.0 / 54.0, -t * 20.0 / 54.0 + 1.0
    return hypot(300.0 + 54.0 * (cos(a) - cos(b)), 54.0 * (sin(a) - sin(b)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("detour_m", [15.0, 20.0, 40.0])
def test_a_way_around_is_refused_from_its_first_range_to_its_last(detour_m, seed):
    """With 1 m of noise and turns the limit is 9 m: detours shorter than that are left to the fault tests."""
    out = refused(circling_m, off_m=lambda t: detour_m if 40.0 <= t < 44.0 or 60.0 <= t < 75.0 else 0.0, seed=seed)
    behind = [t for t in out if 40.0 <= t < 44.0 or 60.0 <= t < 75.0]
    assert len(behind) >= 93
    assert len(out) - len(behind) <= 4 + 2  # two at each return, and one or two in vain


def test_a_way_around_just_beyond_the_limit_is_refused_whole_or_not_at_all_and_used_once_it_is_back():
    """One of 9 m was refused for a single range and then used; one of 8 m was still refused 10 s after its end.

    The band: half of 20 are found.
    """
    found, later = [], []
    for seed in range(20):
        out = refused(lambda _: 718.0, off_m=lambda t: 9.5 * (20.0 <= t < 30.0), seed=seed)
        found.append(len([t for t in out if 20.0 <= t < 30.0]))
        later.append(len([t for t in out if t >= 30.0]))
    assert set(found) == {0, 50}
    assert found.count(50) > 10
    assert max(later) <= 3


@pytest.mark.parametrize("seed", range(5))
def test_what_two_planes_fly_is_no_jump(seed):
    """The band: 600 ranges, each in vain with a probability of 6e-5, and half of the limit is left to the turns."""
    assert len(refused(circling_m, seed=seed)) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_two_that_pass_close_by_are_no_jump(seed):
    assert len(refused(lambda t: hypot(25.0, 40.0 * (t - 60.0)), speed_mps=40.0, seed=seed)) <= 1


@pytest.mark.parametrize("seed", range(5))
def test_a_device_that_scatters_more_than_it_states_is_used(seed):
    """By five times: once its own scatter is known, in half a minute, it counts. The band: some outliers in 400."""
    out = refused(circling_m, noise_m=5.0, seed=seed)
    assert len([t for t in out if t > 40.0]) <= 5


def test_one_outlier_is_refused_alone():
    assert refused(circling_m, off_m=lambda t: 30.0 * (abs(t - 50.0) < 0.1)) == [pytest.approx(50.0)]


def test_a_range_that_jumps_down_has_come_back_at_once():
    """It began too long: the service was started behind a building."""
    out = refused(circling_m, off_m=lambda t: 25.0 * (t < 50.0))
    assert out == pytest.approx([50.0])


def test_a_step_that_lasts_is_believed_after_20_s():
    out = refused(circling_m, off_m=lambda t: 25.0 * (t >= 50.0))
    assert (out[0], out[-1]) == pytest.approx((50.0, 70.2))
    assert len(out) == pytest.approx(101, abs=2)


def test_ranges_too_seldom_for_a_line_and_old_ones_are_not_judged():
    track = RangeTrack()
    assert not any(track.add(1.0 * k, 100.0 + 40.0 * (k % 2), 1.0, 20.0) for k in range(20))
    assert not track.add(18.5, 900.0, 1.0, 20.0)


def test_an_outlier_heard_twice_is_one_outlier():
    track = RangeTrack()
    ranges_m = [130.0 if k == 10 else 100.0 for k in range(20)]
    out = [(k, again) for k, range_m in enumerate(ranges_m) for again in (0, 1) if track.add(0.2 * k, range_m, 1.0, 0.0)]
    assert out == [(10, 0), (10, 1)]


def test_a_range_heard_many_times_after_a_gap_that_began_with_an_outlier_is_one_range():
    """Four of one time make no line: it ended in a division by zero."""
    track = RangeTrack()
    for k in range(10):
        track.add(0.2 * k, 130.0 if k == 9 else 100.0, 1.0, 0.0)
    assert not any(track.add(at_s, 100.0, 1.0, 0.0) for at_s in (10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.2, 10.4))


def test_a_clock_that_jumped_back_does_not_lock_a_way_around_in():
    track = RangeTrack()
    assert [track.add(1000.0 + 0.2 * k, 100.0 + 30.0 * (k >= 10), 1.0, 0.0) for k in range(15)] == [False] * 10 + [True] * 5
    assert not any(track.add(0.2 * k, 130.0, 1.0, 0.0) for k in range(15))


def test_each_peer_and_each_device_is_judged_by_itself():
    jumps = RangeChecks()
    for k in range(10):
        assert not jumps.has_jumped(1, 0, 0.2 * k, 100.0, 0.1, 0.0)
        assert not jumps.has_jumped(2, 0, 0.2 * k, 200.0, 0.1, 0.0)
        assert not jumps.has_jumped(1, 1, 0.2 * k, 120.0, 0.1, 0.0)
    assert jumps.has_jumped(1, 0, 2.0, 120.0, 0.1, 0.0)
    assert not jumps.has_jumped(1, 1, 2.0, 120.0, 0.1, 0.0)


def test_a_device_whose_ranges_all_jump_is_no_way_around():
    """Another device of the vehicle says nothing of it. It is told by the residuals: `all of its ranges jumped`."""
    jumps, seen = RangeChecks(), []
    for k in range(30):
        off_m = 20.0 if k >= 15 else 0.0
        assert not jumps.has_jumped(1, 7, 0.2 * k, 100.0, 0.1, 0.0)
        seen += [
            (k, peer) for peer in (1, 2, 3) if jumps.has_jumped(peer, 0, 0.2 * k + 0.05 * peer, 100.0 * peer + off_m, 0.1, 0.0)
        ]
    assert seen == [(15, 1), (15, 2)]
