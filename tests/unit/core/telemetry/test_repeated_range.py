"""When the same range again and again is a stuck device, and when it is what a sound device tells."""

import numpy as np
import pytest

from gcs_coloc.core.telemetry.range_checks import RepeatedRange

EVERY_S = 0.1
CROSSING_MPS, FORMATION_MPS = 15.0, 0.3


def ranges(rng, sigma_m, step_m, closing_mps=CROSSING_MPS, count=300, from_m=800.0):
    true_m = from_m + closing_mps * EVERY_S * np.arange(count)
    measured = true_m + sigma_m * rng.standard_normal(count)
    if step_m:
        measured = step_m * np.round(measured / step_m)
    return [float(np.float32(value)) for value in measured]


def stuck_after(check, value, most=400):
    """How many repeats of a value it takes until it is refused; infinity for never."""
    for repeat in range(1, most + 1):
        if check.add(value, None):
            return repeat
    return float("inf")


@pytest.mark.parametrize("closing_mps", [CROSSING_MPS, FORMATION_MPS, 0.0])
@pytest.mark.parametrize(("sigma_m", "step_m", "most"), [(0.5, 0.0, 9), (0.05, 0.001, 9), (1.0, 0.01, 9), (2.0, 0.1, 14)])
def test_a_noisy_device_that_repeats_its_last_value_is_found_within_few_repeats(closing_mps, sigma_m, step_m, most):
    for seed in range(20):
        check = RepeatedRange()
        values = ranges(np.random.default_rng(seed), sigma_m, step_m, closing_mps)
        assert not any(check.add(value, None) for value in values)
        assert 2 <= stuck_after(check, values[-1]) <= most


@pytest.mark.parametrize("step_m", [0.0, 0.01, 0.1, 1.0])
@pytest.mark.parametrize("sigma_m", [0.0, 0.02, 0.1, 0.5, 2.0])
def test_a_sound_device_of_any_step_is_never_refused_on_the_move_in_formation_or_standing_still(sigma_m, step_m):
    """Two hours at 10 Hz for each, in all: a single refusal would be one too many."""
    for seed in range(4):
        rng, check = np.random.default_rng(seed), RepeatedRange()
        for leg in range(15):
            closing_mps = (CROSSING_MPS, FORMATION_MPS, 0.0)[leg % 3]
            assert not any(check.add(value, None) for value in ranges(rng, sigma_m, step_m, closing_mps, count=1200))


def test_a_device_that_tells_each_value_several_times_is_not_called_stuck():
    for times in (2, 3, 5):
        check = RepeatedRange()
        for value in ranges(np.random.default_rng(times), 0.5, 0.0):
            assert not any(check.add(value, None) for _ in range(times))


def test_the_same_measurement_heard_over_several_links_is_no_repeat():
    check = RepeatedRange()
    for k, value in enumerate(ranges(np.random.default_rng(1), 0.5, 0.0)):
        check.add(value, k * EVERY_S)
    assert not any(check.add(value, k * EVERY_S) for _ in range(50))
    assert any(check.add(value, k * EVERY_S + repeat) for repeat in range(1, 8))


def test_a_device_that_measures_again_is_believed_with_its_first_new_value_and_found_as_soon_the_next_time():
    check = RepeatedRange()
    values = ranges(np.random.default_rng(2), 0.5, 0.0)
    for value in values:
        check.add(value, None)
    first = stuck_after(check, values[-1])
    for _ in range(500):
        check.add(values[-1], None)
    for value in ranges(np.random.default_rng(3), 0.5, 0.0):
        assert not check.add(value, None)
    assert stuck_after(check, value) <= first


def test_a_device_that_was_stuck_when_it_was_first_heard_is_not_known_to_be():
    assert stuck_after(RepeatedRange(), 812.5) == float("inf")
