"""When all ranges of a device have come to be off by one length, and when it is multipath or the estimator."""

import numpy as np
import pytest

from gcs_coloc.core.measurements import Residual
from gcs_coloc.core.residual_log import RangeJumps

GATE_SIGMAS = 4.0


def residual(at_s, peer, innovation_m, device_of=4):
    refused = "refused: range outside the gate" if abs(innovation_m) > GATE_SIGMAS else None
    return Residual(device_of, peer, at_s, innovation_m, 1.0, innovation_m**2, 1, refused)


def innovations(rng, peers, from_s, to_s, shift_m=0.0, late_share=0.0):
    """Ranges at 10 Hz, one peer after the other."""
    for step in range(round(from_s * 10), round(to_s * 10)):
        for k, peer in enumerate(peers):
            late_m = rng.uniform(5.0, 200.0) if rng.random() < late_share else 0.0
            yield residual(step / 10 + 0.01 * k, peer, float(rng.standard_normal()) + shift_m + late_m)


@pytest.mark.parametrize("peers", [(1, 2), (1, 2, 3), tuple(range(10, 18))])
@pytest.mark.parametrize("shift_m", [20.0, -8.0])
@pytest.mark.parametrize("late_share", [0.0, 0.1])
def test_a_device_whose_ranges_all_jump_is_found_with_the_third_range_or_the_first_to_the_last_peer(peers, shift_m, late_share):
    for seed in range(10):
        rng, jumps = np.random.default_rng(seed), RangeJumps()
        jumps.add(innovations(rng, peers, 0.0, 5.0, 0.0, late_share), 5.0)
        assert jumps.sizes_m(5.0) == {}
        needed = max(3, len(peers))
        for number, r in enumerate(innovations(rng, peers, 5.0, 6.0, shift_m), start=1):
            jumps.add([r], 5.5)
            assert bool(jumps.sizes_m(5.5)) == (number >= needed)
        assert jumps.sizes_m(5.5)[4] == pytest.approx(shift_m, abs=4.0)


@pytest.mark.parametrize("peers", [(1, 2), (1, 2, 3), (1, 2, 3, 5)])
def test_multipath_on_every_fifth_range_is_not_taken_for_a_jump(peers):
    """Ten minutes at 10 Hz: what is by chance refused three times in a row and to all is off by lengths that differ."""
    seen = set()
    jumps = RangeJumps()
    for r in innovations(np.random.default_rng(1), peers, 0.0, 600.0, late_share=0.2):
        jumps.add([r], r.measured_at_s)
        seen |= {round(r.measured_at_s) for _ in jumps.sizes_m(r.measured_at_s)}
    # With two peers, three in a row within 5 of 195 m of each other: 0.2^3 x 2 x (5.7 x 2 / 195)^2 of the ranges at the most.
    assert len(seen) <= (2 * 12000 * 0.008 * 0.0035 * 2 if len(peers) == 2 else 0)


def test_a_position_that_is_wrong_itself_makes_ranges_too_long_and_too_short_and_is_no_jump():
    jumps = RangeJumps()
    jumps.add([residual(0.1 * k, 1 + k % 3, (20.0, -20.0, 15.0)[k % 3]) for k in range(30)], 3.0)
    assert jumps.sizes_m(3.0) == {}


def test_a_single_peer_says_nothing_of_the_device_and_fixes_say_nothing_at_all():
    jumps = RangeJumps()
    jumps.add([residual(0.1 * k, 1, 20.0) for k in range(30)], 3.0)
    jumps.add([residual(0.1 * k, None, 20.0) for k in range(30)], 3.0)
    assert jumps.sizes_m(3.0) == {}


def test_a_jump_is_told_for_a_second_and_is_that_of_one_device():
    jumps = RangeJumps()
    jumps.add([residual(0.1 * k, 1 + k % 3, 20.0) for k in range(6)], 0.6)
    jumps.add([residual(0.1 * k, 1 + k % 3, 0.5, device_of=5) for k in range(6)], 0.6)
    jumps.add([residual(0.7, 1, 0.5)], 0.7)
    assert set(jumps.sizes_m(1.5)) == {4}
    assert jumps.sizes_m(1.7) == {}
