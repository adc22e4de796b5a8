"""Never two senders, and never long none: the hot standby under faults, in simulated time."""

from __future__ import annotations

import random

import pytest
from two_services import TwoServices, Vehicle, gaps, overlaps

from gcs_coloc.core.standby.sign_of_life import StandbyOrder, StandbyReason, StandbyState

SETTLED_S = 4.0


def settled(seed: int, vehicles: list[Vehicle] | None = None) -> TwoServices:
    """Both run, the first one sends."""
    scene = TwoServices(seed, vehicles)
    scene.start(0)
    scene.start(1)
    scene.run(SETTLED_S)
    assert scene.states() == [StandbyState.ACTIVE, StandbyState.STANDBY]
    return scene


@pytest.mark.parametrize("seed", range(40))
def test_after_a_kill_the_other_one_sends_within_half_a_second(seed):
    scene = settled(seed)
    at_s = SETTLED_S + scene.random.uniform(0.0, 1.0)
    scene.at(at_s, lambda: scene.kill(0))
    scene.run(at_s + 5.0)
    (vehicle,) = scene.vehicles
    assert scene.active() == [1]
    assert gaps(vehicle, SETTLED_S, scene.now_s - 0.2) <= 0.5
    assert overlaps(vehicle) == []


@pytest.mark.parametrize("seed", range(20))
def test_by_the_fed_receiver_alone_it_takes_a_moment_longer(seed):
    scene = settled(seed, [Vehicle(4, passes_on=False)])
    at_s = SETTLED_S + scene.random.uniform(0.0, 1.0)
    scene.at(at_s, lambda: scene.kill(0))
    scene.run(at_s + 5.0)
    (vehicle,) = scene.vehicles
    assert gaps(vehicle, SETTLED_S, scene.now_s - 0.2) <= 0.8
    assert overlaps(vehicle) == []


@pytest.mark.parametrize("seed", range(40))
def test_one_that_was_stopped_sends_nothing_when_it_goes_on(seed):
    scene = settled(seed)
    stops_s = SETTLED_S + scene.random.uniform(0.0, 1.0)
    scene.at(stops_s, lambda: scene.stop(0))
    goes_on_s = stops_s + scene.random.choice([0.25, 0.4, 0.6, 1.0, 3.0, 20.0])
    scene.at(goes_on_s, lambda: scene.go_on(0))
    scene.run(goes_on_s + 3.0)
    (vehicle,) = scene.vehicles
    assert overlaps(vehicle, 30.0) == []
    assert len(scene.active()) == 1
    if goes_on_s - stops_s >= 0.6:
        assert scene.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
        assert all(index == 1 for t, index in vehicle.fed if t >= goes_on_s)


@pytest.mark.parametrize("passes_on", [True, False])
@pytest.mark.parametrize("seed", range(20))
def test_a_split_changes_nothing_while_the_vehicle_shows_who_feeds_it(seed, passes_on):
    scene = settled(seed, [Vehicle(4, passes_on=passes_on)])
    scene.split = [True, True]
    scene.run(SETTLED_S + 30.0)
    assert scene.states() == [StandbyState.ACTIVE, StandbyState.STANDBY]
    assert scene.services[1].peer.snapshot(scene.clock_of(1)).sends == "other"
    scene.split = [False, False]
    scene.run(SETTLED_S + 32.0)
    (vehicle,) = scene.vehicles
    assert all(index == 0 for _, index in vehicle.fed)
    assert gaps(vehicle, SETTLED_S, scene.now_s) <= 0.25


@pytest.mark.parametrize("cut", [(True, False), (False, True)])
def test_a_link_that_is_cut_in_one_direction_changes_nothing(cut):
    scene = settled(1)
    scene.split = list(cut)
    scene.run(SETTLED_S + 20.0)
    assert scene.states() == [StandbyState.ACTIVE, StandbyState.STANDBY]


def test_a_vehicle_that_shows_nothing_is_left_to_the_operator():
    scene = settled(1, [Vehicle(4, passes_on=False, reports=False)])
    scene.kill(0)
    scene.run(SETTLED_S + 20.0)
    peer = scene.services[1].peer
    assert scene.active() == []
    assert "take over" in peer.snapshot(scene.clock_of(1)).problem
    assert peer.order(StandbyOrder.TAKE_OVER, scene.clock_of(1)) is None
    scene.run(SETTLED_S + 22.0)
    assert scene.active() == [1]
    assert scene.vehicles[0].fed[-1][1] == 1


def test_a_gps_that_fails_long_after_the_active_one_died_is_aided():
    scene = settled(1, [Vehicle(4, needs_aid=False)])
    scene.kill(0)
    scene.run(SETTLED_S + 60.0)
    assert scene.states()[1] is StandbyState.STANDBY  # nothing to do: nothing changes
    scene.vehicles[0].needs_aid = True
    scene.run(SETTLED_S + 62.0)
    first_s, sender = scene.vehicles[0].fed[0]
    assert sender == 1
    assert first_s <= SETTLED_S + 60.0 + 1.3


def test_a_gps_that_fails_in_a_split_is_aided_by_the_active_one_alone():
    for seed in range(20):
        scene = settled(seed, [Vehicle(4, needs_aid=False)])
        scene.split = [True, True]
        scene.run(SETTLED_S + 20.0)
        scene.vehicles[0].needs_aid = True
        scene.run(SETTLED_S + 40.0)
        assert {index for _, index in scene.vehicles[0].fed} == {0}


@pytest.mark.parametrize("seed", range(10))
def test_one_that_returns_is_passive_until_it_is_told(seed):
    scene = settled(seed)
    scene.kill(0)
    scene.run(SETTLED_S + 3.0)
    scene.start(0)
    scene.run(SETTLED_S + 8.0)
    assert scene.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
    peer = scene.services[0].peer
    assert peer.order(StandbyOrder.STAND_BY, scene.clock_of(0)) is None
    scene.kill(1)
    scene.run(SETTLED_S + 12.0)
    assert scene.active() == [0]
    assert overlaps(scene.vehicles[0]) == []


@pytest.mark.parametrize("seed", range(30))
def test_one_that_returns_to_a_slow_one_is_passive_all_the_same(seed):
    scene = settled(seed)
    scene.kill(0)
    scene.run(SETTLED_S + 3.0)
    scene.services[1].pause_s = 0.8
    scene.start(0)
    scene.run(SETTLED_S + 12.0)
    scene.services[1].pause_s = 0.0
    scene.run(SETTLED_S + 14.0)
    assert scene.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
    assert overlaps(scene.vehicles[0]) == []


@pytest.mark.parametrize("by", [0, 1])
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_change_on_an_operators_word_leaves_no_gap(by, loss):
    for seed in range(10):
        scene = settled(seed)
        scene.loss = loss
        scene.run(SETTLED_S + 1.0)
        order = StandbyOrder.RELEASE if by == 0 else StandbyOrder.TAKE_OVER
        told_s = scene.now_s
        assert scene.services[by].peer.order(order, scene.clock_of(by)) is None
        scene.run(told_s + 6.0)
        assert len(scene.active()) == 1
        assert overlaps(scene.vehicles[0]) == []
        if not loss:
            assert scene.active() == [1]
            assert gaps(scene.vehicles[0], told_s, scene.now_s - 0.2) <= 0.35


def test_taking_over_what_the_other_one_visibly_feeds_is_refused():
    scene = settled(1)
    scene.split = [True, True]
    scene.run(SETTLED_S + 3.0)
    refusal = scene.services[1].peer.order(StandbyOrder.TAKE_OVER, scene.clock_of(1))
    assert refusal is not None
    assert "still fed" in refusal.text
    assert scene.active() == [0]


def test_two_that_are_both_to_be_active_agree_on_one():
    for seed in range(20):
        scene = TwoServices(seed, roles=(True, True))
        scene.start(0)
        scene.run(scene.random.uniform(0.0, 0.5))
        scene.start(1)
        scene.run(10.0)
        assert len(scene.active()) == 1
        assert overlaps(scene.vehicles[0]) == []


FAULTS = ("kill", "stop", "split", "return", "slow")


def fault(scene: TwoServices, kind: str, at_s: float, draw: random.Random) -> float:
    """Let one fault come at a time, and pass; return when it has passed."""
    lasts_s = draw.choice([0.15, 0.25, 0.35, 0.5, 1.0, 3.0, 6.0])
    index = draw.choice([0, 0, 1])
    ends_s = at_s + lasts_s
    match kind:
        case "kill":
            scene.at(at_s, lambda: scene.kill(index))
        case "stop":
            scene.at(at_s, lambda: scene.stop(index))
            scene.at(ends_s, lambda: scene.go_on(index))
        case "split":
            ways = draw.choice([[True, True], [True, False], [False, True]])
            scene.at(at_s, lambda: scene.split.__setitem__(slice(None), ways))
            scene.at(ends_s, lambda: scene.split.__setitem__(slice(None), [False, False]))
        case "return":
            scene.at(at_s, lambda: scene.kill(index))
            scene.at(ends_s, lambda: scene.start(index))
        case "slow":
            scene.at(at_s, lambda: setattr(scene.services[index], "pause_s", draw.choice([0.15, 0.25, 0.4, 0.8])))
            scene.at(ends_s, lambda: setattr(scene.services[index], "pause_s", 0.0))
    return ends_s


@pytest.mark.parametrize("kind", FAULTS)
def test_no_fault_makes_two_send(kind):
    """Two hundred random faults and more, fifty of each kind, on a link that loses and delays messages as well."""
    for seed in range(50):
        draw = random.Random(seed)
        scene = settled(seed, [Vehicle(4), Vehicle(5, needs_aid=draw.random() < 0.5)])
        scene.loss, scene.delay_s = draw.choice([0.0, 0.05, 0.2]), draw.choice([0.001, 0.01, 0.05])
        begins_s = SETTLED_S + draw.uniform(0.5, 1.5)
        ends_s = fault(scene, kind, begins_s, draw)
        scene.at(draw.uniform(SETTLED_S, ends_s + 2.0), lambda s=scene: setattr(s.vehicles[1], "needs_aid", True))
        scene.run(ends_s + 8.0)
        for vehicle in scene.vehicles:
            assert overlaps(vehicle) == [], (kind, seed, vehicle.sysid)
        assert len(scene.active()) == 1, (kind, seed, scene.states())
        # At the longest: one that returns before the other one has taken over listens for a second.
        assert gaps(scene.vehicles[0], SETTLED_S, scene.now_s - 0.3) <= 1.5, (kind, seed)


def test_several_faults_at_once_make_two_send_for_a_moment_at_most():
    """A split and a stop together leave nothing to tell by but the vehicle: what both send ends when it has shown that."""
    longest_s, twice = 0.0, 0
    for seed in range(200):
        draw = random.Random(seed)
        scene = settled(seed)
        scene.loss = draw.choice([0.0, 0.2])
        ends_s = max(fault(scene, draw.choice(FAULTS), SETTLED_S + draw.uniform(0.5, 6.0), draw) for _ in range(4))
        scene.run(ends_s + 10.0)
        found = overlaps(scene.vehicles[0])
        twice += bool(found)
        longest_s = max([longest_s, *(lasted_s for _, lasted_s in found)])
    assert longest_s <= 0.4
    assert twice <= 2


def test_why_it_is_in_its_state_is_told():
    scene = settled(1)
    scene.stop(0)
    scene.run(SETTLED_S + 2.0)
    scene.go_on(0)
    scene.run(SETTLED_S + 4.0)
    snapshots = [service.peer.snapshot(scene.clock_of(index)) for index, service in enumerate(scene.services)]
    assert scene.services[0].peer.reason.reason is StandbyReason.OTHER_IS_ACTIVE
    assert [snapshot.sends for snapshot in snapshots] == ["other", "this"]
    assert snapshots[1].reason == StandbyReason.TOOK_OVER.wording
    assert "does not take over by itself" in snapshots[1].problem


def test_one_that_took_over_by_mistake_stands_back_as_soon_as_it_sees_the_other_ones_stream():
    """The vehicle ceases to pass on and the link is cut in the same moment: all that there is to tell by says the wrong thing."""
    for seed in range(20):
        scene = settled(seed, [Vehicle(4, reports=False)])
        (vehicle,) = scene.vehicles
        vehicle.passes_on, scene.split = False, [True, True]
        scene.run(SETTLED_S + 2.0)
        assert scene.active() == [0, 1]
        vehicle.passes_on = True
        scene.run(SETTLED_S + 3.0)
        assert scene.active() == [0]
        assert max(t for t, index in vehicle.fed if index == 1) < SETTLED_S + 2.4
        scene.run(SETTLED_S + 20.0)
        assert scene.active() == [0]
