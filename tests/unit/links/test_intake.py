"""A flood is cut down to its own share and takes nothing from anybody else's."""

import pytest

from gcs_coloc.links.intake import BURST_S, KEPT_S, LEAST_COST_BYTES, Intake

RATE = 100_000.0
VEHICLE, HOSTILE = "10.0.0.1:14550", "6.6.6.6:6666"


def admitted(intake, source, size, per_s, from_s, seconds):
    """How many of evenly spaced datagrams are admitted."""
    return sum(intake.admits(source, size, from_s + number / per_s) for number in range(round(per_s * seconds)))


@pytest.mark.parametrize("size", [LEAST_COST_BYTES, 300, 1400])
def test_a_flood_gets_its_share_and_a_vehicle_beside_it_everything(size):
    intake = Intake(RATE)
    flood = vehicle = 0
    for number in range(40_000):  # 2 s at 20,000/s, a datagram of the vehicle after every two hundredth
        flood += intake.admits(HOSTILE, size, number / 20_000)
        if number % 200 == 0:
            vehicle += intake.admits(VEHICLE, 400, number / 20_000)
    assert vehicle == 200
    share = RATE * (2.0 + BURST_S)
    assert share - 2 * size <= flood * size <= share
    assert intake.counts["rate_limited"] == 40_000 - flood


@pytest.mark.parametrize("size", [0, 1, LEAST_COST_BYTES])
def test_small_datagrams_are_not_free(size):
    assert admitted(Intake(RATE), HOSTILE, size, 20_000, 0.0, 1.0) == pytest.approx(
        RATE * (1.0 + BURST_S) / LEAST_COST_BYTES, abs=2
    )


def test_no_datagram_is_larger_than_a_burst():
    intake = Intake(RATE)
    assert not intake.admits(HOSTILE, round(RATE * BURST_S) + 1, 0.0)
    assert intake.admits(HOSTILE, round(RATE * BURST_S), 0.0)


def test_what_was_held_back_comes_through_at_once():
    intake = Intake(RATE)
    assert all(intake.admits(VEHICLE, 400, 5.0) for _ in range(50))


def test_who_was_cut_down_is_heard_again_as_soon_as_it_is_quiet():
    intake = Intake(RATE)
    admitted(intake, HOSTILE, 1000, 1000, 0.0, 1.0)
    assert not intake.admits(HOSTILE, 1000, 1.0)
    assert intake.admits(HOSTILE, 1000, 1.0 + 1000 / RATE)


def test_made_up_addresses_share_one_share_and_push_nobody_out():
    intake = Intake(RATE, max_sources=100)
    assert intake.admits(VEHICLE, 400, 0.0)
    taken = 0
    for number in range(200_000):  # 10 s at 20,000/s, each from another address
        now_s = number / 20_000
        taken += intake.admits(("6.6.6.6", number), 1000, now_s)
        if number % 2000 == 0:
            assert intake.admits(VEHICLE, 400, now_s)
    assert intake.sources == 100
    # One datagram of each of the first 99, and one share for all others.
    assert taken == pytest.approx(99 + RATE * (10.0 + BURST_S) / 1000, abs=2)


def test_silent_sources_make_room():
    intake = Intake(RATE, max_sources=2)
    for source in ("a", "b"):
        intake.admits(source, 400, 0.0)
    for _ in range(200):
        intake.admits("c", 1000, KEPT_S - 0.1)
    assert not intake.admits("d", 1000, KEPT_S - 0.1)  # as it shares with c
    assert intake.admits("d", 1000, KEPT_S)
    assert intake.sources == 2
