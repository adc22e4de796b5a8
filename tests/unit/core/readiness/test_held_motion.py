"""Held motion: circles and straight ways, and turn rates from velocities."""

from __future__ import annotations

from math import cos, hypot, pi, sin

import pytest

from gcs_coloc.core.readiness.held_motion import HeldMotion, TurnRate


def test_straight_on() -> None:
    later = HeldMotion((1.0, 2.0, 3.0), (10.0, -5.0, 1.0)).after(2.0)
    assert later.position == (21.0, -8.0, 5.0)
    assert later.velocity == (10.0, -5.0, 1.0)


def test_a_quarter_of_a_circle_clockwise_from_north_ends_eastbound() -> None:
    turn = 0.1
    later = HeldMotion((0.0, 0.0, 100.0), (0.0, 20.0, 0.0), turn).after(0.5 * pi / turn)
    assert later.position == pytest.approx((200.0, 200.0, 100.0))
    assert later.velocity == pytest.approx((20.0, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("turn", [-0.2, 1e-6, 0.2])
def test_small_steps_come_to_the_same_place_as_one(turn: float) -> None:
    motion = HeldMotion((0.0, 0.0, 0.0), (12.0, 16.0, 0.5), turn)
    steps = motion
    for _ in range(300):
        steps = steps.after(0.1)
    assert steps.position == pytest.approx(motion.after(30.0).position, rel=1e-4)
    assert hypot(*steps.velocity[:2]) == pytest.approx(20.0)


def test_a_formation_stays_together() -> None:
    leader = HeldMotion((0.0, 0.0, 100.0), (0.0, 20.0, 0.0), 0.06)
    follower = HeldMotion((0.0, -300.0, 100.0), (1.0, 19.5, 0.2), 0.05)
    apart = follower.in_formation_with(leader).after(30.0).position
    e, n, u = leader.after(30.0).position
    assert apart == pytest.approx((e, n - 300.0, u))


@pytest.mark.parametrize(
    ("velocity", "turn", "leader_mps"),
    [((0.0, 20.0, 0.0), 0.1, 20.0), ((5.0, 20.0, 0.0), 0.05, 20.0), ((0.0, 0.0, 0.0), 0.05, 2.0)],
)
def test_who_turns_or_flies_otherwise_or_stands_is_in_no_formation(
    velocity: tuple[float, float, float], turn: float, leader_mps: float
) -> None:
    motion = HeldMotion((0.0, -300.0, 100.0), velocity, turn)
    assert motion.in_formation_with(HeldMotion((0.0, 0.0, 100.0), (0.0, leader_mps, 0.0), 0.06)) is motion


@pytest.mark.parametrize("turn", [-0.25, 0.0, 0.1])
def test_a_turn_rate_is_found_across_north(turn: float) -> None:
    rates = TurnRate()
    for t in range(12):
        course = 0.3 - turn * 11.0 + turn * t
        rates.add(float(t), 20.0 * sin(course), 20.0 * cos(course))
    assert rates.radps == pytest.approx(turn, abs=1e-9)


def test_who_is_slow_or_just_heard_does_not_turn() -> None:
    rates = TurnRate()
    assert rates.radps == 0.0
    rates.add(0.0, 20.0, 0.0)
    rates.add(1.0, 0.0, 20.0)
    assert rates.radps == 0.0
    for t in range(10):
        rates.add(2.0 + t, 0.1 * (t % 3), 0.1)
    assert rates.radps == 0.0
