from __future__ import annotations

import math

import numpy as np
import pytest

from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, NoiseLevel, NoiseSplit


def stream(white_m: float, slow_m: float, hz: float, seconds: float, seed: int, accel_mps2: float = 0.0) -> NoiseSplit:
    rng = np.random.default_rng(seed)
    split = NoiseSplit()
    slow = slow_m * rng.normal(size=2)
    decay = math.exp(-1.0 / hz / 100.0)
    for k in range(int(hz * seconds)):
        t = k / hz
        slow = decay * slow + math.sqrt(1.0 - decay**2) * slow_m * rng.normal(size=2)
        z = 22.0 * t + 0.5 * accel_mps2 * t * t + slow + white_m * rng.normal(size=2)
        split = split.updated(t, (tuple(z.tolist()),), (math.hypot(white_m, slow_m),))
    return split


def test_white_noise_is_recognised():
    white, slow = stream(15.0, 0.0, 50.0, 60.0, seed=1).split(0, 15.0, 0.1)
    # 3000 samples of two axes, faded over 1000: 3 % of standard error in the variance, three of them.
    assert white == pytest.approx(15.0, rel=0.05)
    assert slow == pytest.approx(1.5)


def test_a_drifting_error_is_not_taken_for_white():
    white, slow = stream(0.02, 3.0, 10.0, 120.0, seed=2).split(0, 3.0, 0.1)
    assert white < 0.4
    assert slow > 2.9


def test_a_manoeuvre_is_not_taken_for_noise():
    white, slow = stream(0.0, 0.0, 5.0, 30.0, seed=3, accel_mps2=9.0).split(0, 1.0, 0.1)
    assert white <= 0.3
    assert slow == pytest.approx(1.0, rel=0.01)


def test_nothing_is_proven_by_a_few_reports():
    white, slow = stream(15.0, 0.0, 10.0, 0.5, seed=4).split(0, 15.0, 0.1)
    assert slow > 12.0
    assert white > 12.0


def test_a_gap_starts_the_comparison_anew():
    split, other = NoiseSplit(), NoiseSplit()
    smooth = ((0.0, 0.0), (0.1, 2.0), (0.2, 4.0), (60.0, 900.0), (60.1, 902.0), (60.2, 904.0), (60.3, 906.0))
    for t, z in smooth:
        split = split.updated(t, ((z,),), (1.0,))
    for t, z in smooth[3:]:
        other = other.updated(t, ((z,),), (1.0,))
    assert split.split(0, 1.0, 0.1) == other.split(0, 1.0, 0.1)


def test_groups_of_one_stream_are_told_apart_as_streams_of_their_own():
    rng = np.random.default_rng(6)
    both, rough, fine = NoiseSplit(), NoiseSplit(), NoiseSplit()
    for k in range(200):
        e, n, u = (rng.normal(size=3) * (3.0, 3.0, 0.2)).tolist()
        both = both.updated(0.1 * k, ((e, n), (u,)), (3.0, 1.0))
        rough = rough.updated(0.1 * k, ((e, n),), (3.0,))
        fine = fine.updated(0.1 * k, ((u,),), (1.0,))
    assert both.split(0, 3.0, 0.1) == rough.split(0, 3.0, 0.1)
    assert both.split(1, 1.0, 0.1) == fine.split(0, 1.0, 0.1)


def test_a_scatter_is_proven_by_many_reports_and_never_more_than_there_is():
    assert NO_SAMPLES.lower_bound_m(0) == 0.0
    assert 0.75 < stream(1.0, 0.0, 10.0, 120.0, seed=4).lower_bound_m(0) < 1.0
    assert max(stream(1.0, 0.0, 10.0, 2.0, seed).lower_bound_m(0) for seed in range(20)) < 1.0
    assert stream(0.02, 3.0, 10.0, 120.0, seed=2).lower_bound_m(0) < 0.4


@pytest.mark.parametrize("size", [0.4, 0.7, 1.0, 1.5, 4.0])
def test_the_noise_level_settles_where_corrections_are_a_little_smaller_than_predicted(size):
    """The predicted variance grows as the root of the level, as a filter's does."""
    rng, noise = np.random.default_rng(1), NoiseLevel()
    levels = []
    for k in range(1, 6001):
        t = 0.1 * k
        noise.learn(t, 20.0, (0.1, 20.0))
        levels.append(noise.log_level)
        gain = 0.1 * math.exp(0.25 * noise.log_level)
        e, n = size * rng.standard_normal(2) * math.exp(-0.25 * noise.log_level)
        noise.corrections.update(t, 3.0, (gain, 0.0), (0.0, gain), (0.0, 0.0), (e, n))
    assert math.log(0.1) <= min(levels)
    assert max(levels) <= math.log(20.0)
    settled = math.exp(np.mean(levels[3000:]))
    # Where the corrections have 0.7 of the predicted variance: size^2 / sqrt(level) = 0.7.
    assert settled == pytest.approx(min(max((size**2 / 0.7) ** 2, 0.1), 20.0), rel=0.35)


def test_a_long_pause_teaches_no_more_than_a_second():
    noise = NoiseLevel()
    for t in (0.0, 0.1):
        noise.corrections.update(t, 3.0, (0.1,), (0.0,), (0.0,), (10.0,))
    noise.learn(3600.0, 20.0, (0.01, 100.0))
    assert 0.0 < noise.log_level <= 10.0 / 20.0


def test_a_copy_of_a_noise_level_learns_apart():
    noise = NoiseLevel(1.0)
    other = noise.copy()
    other.corrections.update(0.0, 3.0, (0.1,), (0.0,), (0.0,), (10.0,))
    other.learn(0.5, 20.0, (0.01, 100.0))
    assert (noise.log_level, noise.corrections.at_s) == (1.0, -math.inf)
    assert other.log_level > 1.0


def reported(at_s: float, velocity_mps: tuple[float, float] | None) -> PositionMeasurement:
    """Return a report at a time with a velocity of 0.2 m/s."""
    velocity = None if velocity_mps is None else (*velocity_mps, 0.0)
    return PositionMeasurement(1, at_s, at_s, (0.0, 0.0, 50.0), 1.0, 1.0, velocity, None if velocity is None else 0.2)


def untold(from_s: float, to_s: float) -> None:
    """What a vehicle tells by its tilt that has none."""


def level_after(accelerations_mps: float, seed: int, end_s: float = 60.0, step_s: float = 0.2) -> float:
    """Return the level that reports teach, at 0.5 m^2/s^3, where each second changes the velocity by so many m/s, 1-sigma."""
    rng, noise, velocity = np.random.default_rng(seed), NoiseLevel(), np.zeros(2)
    for k in range(round(end_s / step_s)):
        velocity = velocity + accelerations_mps * math.sqrt(step_s) * rng.normal(size=2)
        east, north = (velocity + 0.2 * rng.normal(size=2)).tolist()
        noise.learn_from_report(reported(step_s * k, (east, north)), 0.5, 20.0, 300.0, untold)
    return noise.level


def test_reports_teach_the_level_of_the_manoeuvres():
    """At the level at which the change of the velocity has 0.7 of its predicted variance, within a factor as it scatters."""
    levels = [level_after(4.0, seed) for seed in range(20)]
    assert np.exp(np.mean(np.log(levels))) == pytest.approx(4.0**2 / 0.5 / 0.7, rel=0.35)


def test_neither_steady_flight_nor_the_noise_of_its_velocity_teaches_a_level():
    """It is never below 1: a vehicle that hovered may fly off as it loses its GPS."""
    assert [level_after(0.0, seed) for seed in range(5)] == [1.0] * 5


def test_a_level_learned_from_reports_has_a_bound():
    noise = NoiseLevel()
    for k in range(100):
        noise.learn_from_report(reported(2.0 * k, (20.0 * (-1) ** k, 0.0)), 0.5, 20.0, 4.0, untold)
    assert noise.level == pytest.approx(4.0)


@pytest.mark.parametrize("velocity_mps", [None, (20.0, 0.0)])
def test_reports_without_velocity_or_long_apart_teach_nothing(velocity_mps):
    noise = NoiseLevel()
    for k in range(10):
        noise.learn_from_report(reported(5.0 * k, velocity_mps if k % 2 else (0.0, 0.0)), 0.5, 20.0, 300.0, untold)
    assert noise.log_level == 0.0


def test_what_its_tilt_tells_is_no_manoeuvre_as_long_as_it_tells():
    """A vehicle that goes to and fro at 15 m/s: its level is 1 with the tilt, and that of the manoeuvres without."""
    noise, other = NoiseLevel(), NoiseLevel()
    for k in range(60):
        east_mps = 15.0 * (-1) ** k
        noise.learn_from_report(reported(2.0 * k, (east_mps, 0.0)), 0.5, 20.0, 300.0, lambda *_, now=east_mps: (2.0 * now, 0.0))
        other.learn_from_report(reported(2.0 * k, (east_mps, 0.0)), 0.5, 20.0, 300.0, untold)
    assert noise.level == 1.0
    assert noise.untold_level == other.level == other.untold_level > 50.0
    assert noise.copy().untold_level == noise.untold_level


def test_without_tilt_the_level_falls_again_as_the_corrections_do():
    """One that went to and fro at 15 m/s flies straight on once it is located: nothing holds its level up."""
    noise = NoiseLevel()
    for k in range(60):
        noise.learn_from_report(reported(2.0 * k, (15.0 * (-1) ** k, 0.0)), 0.5, 20.0, 300.0, untold)
    before = noise.untold_level
    for k in range(1, 600):
        noise.learn(120.0 + 0.1 * k, 20.0, (0.03, 300.0))
        noise.corrections.update(120.0 + 0.1 * k, 3.0, (0.1, 0.0), (0.0, 0.1), (0.0, 0.0), (0.0, 0.0))
    assert noise.untold_level < 0.2 * before
