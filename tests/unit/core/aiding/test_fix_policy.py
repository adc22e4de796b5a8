"""When an answer may be stated as a fix, by hand-moved time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gcs_coloc.core.aiding.fix_policy import FixPolicy
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.measurements import Estimate, NoEstimate, NoEstimateReason, ProtectionLevel, Unlocated


def known(
    at_s: float, sigma_m: float = 2.0, ranges: int = 3, hdop: float | None = 1.0, untested: tuple[int, ...] = ()
) -> Estimate:
    covariance = np.diag([sigma_m**2, 1.0, 9.0, 0.25, 0.25, 0.25])
    return Estimate(4, at_s, np.zeros(3), np.zeros(3), covariance, hdop, ranges, ProtectionLevel(2.0 * sigma_m, 9.0, untested))


def unknown(at_s: float) -> NoEstimate:
    return NoEstimate(4, at_s, Unlocated(NoEstimateReason.OTHER, detail="too few ranges"))


def inhibited(policy: FixPolicy, answer: Estimate | NoEstimate, at_s: float, **known) -> str | None:
    """Why the policy states no fix, in words."""
    inhibit = policy.inhibit(answer, at_s, **{"own_gps": False, **known})
    return inhibit.text if inhibit is not None else None


def asked(policy: FixPolicy, answers, start_s: float, own_gps: bool = False) -> list[str | None]:
    """The policy's words on one answer each 0.1 s."""
    return [inhibited(policy, answer, start_s + i / 10, own_gps=own_gps) for i, answer in enumerate(answers)]


def test_the_first_fix_is_not_waited_for():
    policy = FixPolicy(AidingSettings(), 0.0)
    assert asked(policy, [unknown(0.0), unknown(0.1), known(0.2)], 0.0) == ["too few ranges", "too few ranges", None]


def test_no_ranges_have_ceased_before_the_first_estimate():
    """A pilot was told to land now, as a vehicle that had waited for ranges for seconds was located."""
    policy = FixPolicy(AidingSettings(), 0.0)
    assert None not in asked(policy, [unknown(0.0)] * 120, 0.0)
    assert inhibited(policy, known(12.0, ranges=0), 12.0) is None
    assert policy.prediction_left_s(12.0) == pytest.approx(AidingSettings().prediction_s, abs=0.11)


def test_a_level_beyond_the_limit_before_the_first_fix_delays_it_by_a_second():
    policy = FixPolicy(AidingSettings(), 0.0)
    assert None not in asked(policy, [unknown(0.0), known(0.1, sigma_m=26.0)], 0.0)
    words = asked(policy, [known(0.2)] * 20, 0.2)
    assert words.index(None) / 10 == pytest.approx(1.0, abs=0.11)


TOO_UNCERTAIN = NoEstimate(4, 1.0, Unlocated(NoEstimateReason.TOO_UNCERTAIN, 300.0))


@pytest.mark.parametrize(
    ("faults", "sigma_m", "expected_s"),
    [
        ([unknown(1.0)], 2.0, 3.0),
        ([known(1.0, sigma_m=26.0)], 20.0, 1.0),
        ([known(1.0, sigma_m=26.0)], 2.0, 1.0),
        ([known(1.0, sigma_m=26.0), TOO_UNCERTAIN, known(1.0, sigma_m=26.0)], 2.0, 1.0),
        ([known(1.0, sigma_m=26.0), unknown(1.0)], 2.0, 3.0),
    ],
)
def test_a_fix_that_was_lost_comes_back_once_it_has_been_sound_and_sooner_after_a_gap(faults, sigma_m, expected_s):
    policy = FixPolicy(AidingSettings(), 0.0)
    assert asked(policy, [known(0.0)] * 10, 0.0) == [None] * 10
    assert None not in asked(policy, faults, 1.0)
    after = asked(policy, [known(1.3, sigma_m=sigma_m)] * 40, 1.3)
    returned_after_s = after.index(None) / 10
    assert returned_after_s == pytest.approx(expected_s, abs=0.11)
    assert set(after[after.index(None) :]) == {None}


def test_a_protection_level_that_swings_about_the_limit_gives_a_fix_that_waits_a_second_each_time():
    """Along a convoy it does so for minutes: each fix is within its level, and an EKF gives up 7 s after the last one."""
    policy = FixPolicy(AidingSettings(), 0.0)
    answers = [known(0.0, sigma_m=26.0 if i % 20 == 0 else 20.0) for i in range(200)]
    words = asked(policy, answers, 0.0)
    assert {i % 20 for i, word in enumerate(words) if word is None} == set(range(11, 20))


def test_a_protection_level_beyond_the_limit_is_named_with_both():
    (word,) = asked(FixPolicy(AidingSettings(alert_limit_m=30.0), 0.0), [known(0.0, sigma_m=15.1)], 0.0)
    assert word == "protection level 30.2 m is beyond the alert limit of 30 m"  # not 30 m, beyond 30 m


def test_prediction_alone_is_a_fix_for_ten_seconds_and_no_longer_however_small_its_bound():
    policy = FixPolicy(AidingSettings(), 0.0)
    assert asked(policy, [known(0.0)], 0.0) == [None]
    words = asked(policy, [known(0.1, ranges=0)] * 150, 0.1)
    assert [word is None for word in words].count(True) == 100
    assert words[-1] == "no range has been in use for 10 s: prediction alone"
    assert asked(policy, [known(15.2)] * 40, 15.2).count(None) == 10  # watched for 3 s first


def test_a_vehicle_with_its_own_gps_in_the_answer_needs_no_ranges():
    policy = FixPolicy(AidingSettings(), 0.0)
    assert asked(policy, [known(0.0, ranges=0)] * 300, 0.0, own_gps=True) == [None] * 300


def test_a_position_that_half_of_its_ranges_contradict_is_no_fix_however_small_its_bound():
    policy = FixPolicy(AidingSettings(), 0.0)
    assert inhibited(policy, known(0.0), 0.0, own_gps=False, median_nis=0.9) is None
    word = inhibited(policy, known(0.1), 0.1, own_gps=False, median_nis=4.0)
    assert word == "half of its ranges are 2.0 sigma or more off where it is held to be"
    assert inhibited(policy, known(0.2), 0.2, own_gps=False, median_nis=0.5) == "good enough again, watched for 3 s"


def test_the_ranges_say_nothing_of_a_vehicle_on_its_own_gps():
    assert inhibited(FixPolicy(AidingSettings(), 0.0), known(0.0), 0.0, own_gps=True, median_nis=9.0) is None


def test_no_fix_is_claimed_from_the_jump_of_all_ranges_until_the_position_has_been_watched_for_three_seconds():
    policy = FixPolicy(AidingSettings(), 0.0)
    assert inhibited(policy, known(0.0), 0.0, own_gps=False) is None
    assert inhibited(policy, known(0.1), 0.1, own_gps=False, range_jump_m=19.6) == "all of its ranges jumped by 20 m"
    assert inhibited(policy, known(0.2), 0.2, own_gps=False) == "good enough again, watched for 3 s"
    assert inhibited(policy, known(3.3), 3.3, own_gps=False) is None
    assert inhibited(policy, known(3.4), 3.4, own_gps=True, range_jump_m=19.6) is None


@pytest.mark.parametrize("answer", [known(0.0, ranges=1, hdop=None), known(0.0, hdop=46.0), known(0.0, hdop=float("inf"))])
def test_ranges_to_one_peer_or_along_one_line_are_a_fix_for_ten_seconds_where_nothing_tells_how_the_vehicle_moves(answer):
    policy = FixPolicy(AidingSettings(), 0.0)
    words = asked(policy, [answer] * 150, 0.0)
    assert [word is None for word in words].count(True) == 101
    assert words[-1] == "its ranges, to one peer or along one line, have not fixed its place for 10 s"
    assert asked(policy, [known(15.0)] * 40, 15.0).count(None) == 10  # watched for 3 s first


@pytest.mark.parametrize("tells", [{"air_data": True}, {"own_gps": True}])
def test_ranges_to_one_peer_do_for_as_long_as_the_bound_says_where_the_vehicle_tells_how_it_moves(tells):
    policy = FixPolicy(AidingSettings(), 0.0)
    words = [inhibited(policy, known(0.0, ranges=1, hdop=None), i / 10, **{"own_gps": False, **tells}) for i in range(600)]
    assert set(words) == {None}


def test_air_data_that_the_estimator_refuses_tell_nothing_of_how_the_vehicle_moves():
    policy, answer = FixPolicy(AidingSettings(), 0.0), replace(known(0.0, ranges=1, hdop=None), refuses_air_data=True)
    words = [inhibited(policy, answer, i / 10, air_data=True) for i in range(150)]
    assert [word is None for word in words].count(True) == 101


def test_an_estimator_that_tells_no_dilution_is_believed_with_two_ranges():
    assert set(asked(FixPolicy(AidingSettings(), 0.0), [known(0.0, ranges=2, hdop=None)] * 200, 0.0)) == {None}


@pytest.mark.parametrize(("determined_of_ten", "is_fix"), [(1, False), (4, True)])
def test_a_moment_in_which_ranges_seem_to_fix_the_place_does_not_make_it_known(determined_of_ten, is_fix):
    policy = FixPolicy(AidingSettings(), 0.0)
    words = asked(policy, [known(0.0, hdop=20.0 if i % 10 < determined_of_ten else 200.0) for i in range(600)], 0.0)
    assert set(words[300:]) == {None} if is_fix else None not in words[300:]


def test_an_estimate_without_a_protection_level_is_no_fix():
    answer = replace(known(0.0), protection=None)
    assert asked(FixPolicy(AidingSettings(), 0.0), [answer], 0.0) == ["its position has no protection level"]


def test_a_receiver_that_nothing_tests_ends_the_fix_only_where_tests_are_required():
    answers = [known(0.0, untested=(2, 3))]
    assert asked(FixPolicy(AidingSettings(), 0.0), answers, 0.0) == [None]
    (text,) = asked(FixPolicy(AidingSettings(require_fault_tests=True), 0.0), answers, 0.0)
    assert text == "its ranges cannot test the positions of 2 and 3, and require_fault_tests is set"
