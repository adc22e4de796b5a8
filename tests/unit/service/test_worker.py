"""How soon a worker that died is started again."""

import pytest

from gcs_coloc.service.worker import BackOff


def test_the_pause_doubles_with_each_death_up_to_a_bound_and_is_short_again_after_a_steady_life():
    back_off = BackOff()
    assert [back_off.pause_s(1.0) for _ in range(9)] == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0])
    assert [back_off.pause_s(lived_s) for lived_s in (30.0, 1.0, 29.0)] == pytest.approx([0.1, 0.2, 0.4])
