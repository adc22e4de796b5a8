"""The benchmark of receivers that come back tells right ones from wrong ones."""

from dataclasses import replace
from math import inf

import pytest

from bench.integrity_flights import Scenario
from bench.returning import fly

RIGHT = Scenario(mutual=False, returns_at_s=40.0)


def test_a_right_one_is_believed_after_ten_seconds_and_one_200_m_off_is_found_before():
    healthy_s, _ = fly((RIGHT, 1))
    assert healthy_s == pytest.approx(10.2, abs=0.01)
    healthy_s, found_s = fly((replace(RIGHT, return_jump_m=200.0), 1))
    assert healthy_s == inf
    assert found_s < 4.0
