"""The clock of one sender, from its stamps as they arrive."""

import pytest

from gcs_coloc.core.clocks.sender_clock import SenderClock


def test_the_mean_wait_is_of_all_stamps_and_not_of_the_first_ones_of_ten_seconds():
    clock = SenderClock()
    for n in range(32):
        clock.learn(0.2 * n, 0.2 * n + (0.0 if n == 0 else 0.3))
        clock.mean_wait_s()
    assert clock.mean_wait_s() == pytest.approx(0.3, abs=0.02)
