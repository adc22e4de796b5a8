"""A flood is cut down to its own share and takes nothing from anybody else's."""

import random

import pytest

from gcs_coloc.links.rate_limiter import BURST_S, KEPT_S, LEAST_COST_BYTES, RateLimiter

RATE = 100_000.0
VEHICLE, HOSTILE = "10.0.0.1:14550", "6.6.6.6:6666"


def admitted(rate_limiter, source, size, per_s, from_s, seconds):
    """How many of evenly spaced datagrams are admitted."""
    return sum(rate_limiter.admits(source, size, from_s + number / per_s) for number in range(round(per_s * seconds)))


@pytest.mark.parametrize("size", [LEAST_COST_BYTES, 300, 1400])
def test_a_flood_gets_its_share_and_a_vehicle_beside_it_everything(size):
    rate_limiter = RateLimiter(RATE)
    rate_limiter.add_source(VEHICLE, 0.0)
    flood = vehicle = 0
    for number in range(40_000):  # 2 s at 20,000/s, a datagram of the vehicle after every two hundredth
        flood += rate_limiter.admits(HOSTILE, size, number / 20_000)
        if number % 200 == 0:
            vehicle += rate_limiter.admits(VEHICLE, 400, number / 20_000)
    assert vehicle == 200
    share = RATE * (2.0 + BURST_S)
    assert share - size <= flood * size <= share + size
    assert rate_limiter.counts["rate_limited"] == 40_000 - flood


@pytest.mark.parametrize("size", [0, 1, LEAST_COST_BYTES])
def test_small_datagrams_are_not_free(size):
    assert admitted(RateLimiter(RATE), HOSTILE, size, 20_000, 0.0, 1.0) == pytest.approx(
        RATE * (1.0 + BURST_S) / LEAST_COST_BYTES, abs=2
    )


def test_no_datagram_is_larger_than_a_burst():
    rate_limiter = RateLimiter(RATE)
    assert not rate_limiter.admits(HOSTILE, round(RATE * BURST_S) + 1, 0.0)
    assert rate_limiter.admits(HOSTILE, round(RATE * BURST_S), 0.0)


@pytest.mark.parametrize("known", [True, False])
def test_a_known_source_has_no_more_than_its_share(known):
    rate_limiter = RateLimiter(RATE)
    if known:
        rate_limiter.add_source(HOSTILE, 0.0)
    assert admitted(rate_limiter, HOSTILE, 1000, 20_000, 0.0, 2.0) == pytest.approx(RATE * (2.0 + BURST_S) / 1000, abs=2)


def test_what_was_held_back_comes_through_at_once():
    rate_limiter = RateLimiter(RATE)
    assert all(rate_limiter.admits(VEHICLE, 400, 5.0) for _ in range(50))


def test_who_was_cut_down_is_heard_again_as_soon_as_it_is_quiet():
    rate_limiter = RateLimiter(RATE)
    admitted(rate_limiter, HOSTILE, 1000, 1000, 0.0, 1.0)
    assert not rate_limiter.admits(HOSTILE, 1000, 1.0)
    assert rate_limiter.admits(HOSTILE, 1000, 1.0 + 1000 / RATE)


def test_made_up_addresses_have_one_share_together_and_take_none_from_a_vehicle():
    rate_limiter = RateLimiter(RATE)
    rate_limiter.add_source(VEHICLE, 0.0)
    taken = 0
    for number in range(100_000):  # 5 s at 20,000/s, each from another address
        now_s = number / 20_000
        taken += rate_limiter.admits(("6.6.6.6", number), 1000, now_s)
        if number % 2000 == 0:
            assert rate_limiter.admits(VEHICLE, 400, now_s)
    assert rate_limiter.sources == 1
    assert taken == pytest.approx(RATE * (5.0 + BURST_S) / 1000, abs=2)


def test_a_vehicle_that_turns_up_during_a_flood_gets_through_and_is_then_known():
    rate_limiter = RateLimiter(RATE)
    rng = random.Random(1)
    # A vehicle that sends 400 bytes twenty times a second among 20,000 small hostile datagrams, for 10 s: of 16,000 places that
    # the share has, every thousandth is the vehicle's, so 16 are expected, and fewer than 4 in one seed of 5000.
    through = 0
    for number in range(200_000):
        now_s = number / 20_000
        through += rate_limiter.admits(VEHICLE, 400, now_s) if rng.random() < 0.001 else 0
        rate_limiter.admits(("6.6.6.6", number), 60, now_s)
    assert through >= 4
    rate_limiter.add_source(VEHICLE, 10.0)
    assert all(rate_limiter.admits(VEHICLE, 400, 10.0) for _ in range(50))


def test_lively_sources_are_kept_and_silent_ones_make_room():
    rate_limiter = RateLimiter(RATE, max_sources=2)
    rate_limiter.add_source("a", 0.0)
    rate_limiter.add_source("b", 0.0)
    rate_limiter.add_source("c", KEPT_S - 0.1)
    assert rate_limiter.sources == 2
    assert sum(rate_limiter.admits("c", 1000, KEPT_S) for _ in range(100)) < 100  # as one of all others
    assert rate_limiter.admits("a", 400, KEPT_S)
    rate_limiter.add_source("c", KEPT_S)
    assert rate_limiter.sources == 2
    assert rate_limiter.admits("c", 1000, KEPT_S)  # in the place of b
    rate_limiter.add_source("b", KEPT_S)
    assert not rate_limiter.admits("b", 1000, KEPT_S)


def test_a_proven_vehicle_takes_the_bucket_of_one_that_is_not_and_none_of_another_proven_one():
    limiter = RateLimiter(10_000.0, max_sources=3)
    limiter.add_source("proven", 0.0, 1)
    limiter.add_source("forged", 0.1)
    limiter.add_source("forged too", 0.2)
    limiter.add_source("newcomer", 0.3)
    limiter.add_source("moved", 0.4, 2)
    limiter.add_source("moved too", 0.5, 3)
    limiter.add_source("one more", 0.6, 4)
    flood = [limiter.admits("stranger", 1000, 1.0) for _ in range(10)]
    assert not all(flood)
    assert {source: limiter.admits(source, 100, 1.0) for source in ("proven", "moved", "moved too")} == dict.fromkeys(
        ("proven", "moved", "moved too"), True
    )
    assert not any(limiter.admits(source, 100, 1.0) for source in ("forged", "forged too", "newcomer", "one more"))


def test_a_proven_vehicle_that_moves_leaves_its_bucket_behind_also_where_all_sources_are_proven():
    limiter = RateLimiter(10_000.0, max_sources=3)
    for vehicle in (1, 2, 3):
        limiter.add_source(f"port of {vehicle}", 0.0, vehicle)
    limiter.add_source("new port of 2", 1.0, 2)
    assert not all(limiter.admits("stranger", 1000, 1.0) for _ in range(10))
    assert all(limiter.admits(source, 100, 1.0) for source in ("port of 1", "new port of 2", "port of 3"))
    assert not limiter.admits("port of 2", 100, 1.0)


def test_an_address_that_two_proven_vehicles_share_stays_proven_when_one_of_them_leaves():
    limiter = RateLimiter(10_000.0, max_sources=2)
    for vehicle in (1, 2):
        limiter.add_source("router", 0.0, vehicle)
    limiter.add_source("forged", 0.1)
    limiter.add_source("port of 2", 0.2, 2)
    assert not all(limiter.admits("stranger", 1000, 1.0) for _ in range(10))
    assert all(limiter.admits(source, 100, 1.0) for source in ("router", "port of 2"))


def test_of_silent_sources_the_unproven_one_makes_room_first():
    limiter = RateLimiter(10_000.0, max_sources=2)
    limiter.add_source("proven", 0.0, 1)
    limiter.add_source("unproven", 0.1)
    limiter.add_source("newcomer", 0.1 + KEPT_S)
    assert not all(limiter.admits("stranger", 1000, 11.0) for _ in range(10))
    assert {name: limiter.admits(name, 100, 11.0) for name in ("proven", "newcomer", "unproven")} == {
        "proven": True,
        "newcomer": True,
        "unproven": False,
    }
