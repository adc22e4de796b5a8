"""Never two senders, and never long none: the hot standby under faults, in simulated time."""

from __future__ import annotations

import random

import pytest
from two_services import TwoServices, Vehicle, gaps, overlaps

from gcs_coloc.core.standby.sign_of_life import StandbyOrder, StandbyReason, StandbyState

SETTLED_S = 4.0


def settled(seed: int, vehicles: list[Vehicle] | None = None) -> TwoServices:
    """Both run, the first one sends."""
    pair = TwoServices(seed, vehicles)
    pair.start(0)
    pair.start(1)
    pair.run(SETTLED_S)
    assert pair.states() == [StandbyState.ACTIVE, StandbyState.STANDBY]
    return pair


@pytest.mark.parametrize("seed", range(40))
def test_after_a_kill_the_other_one_sends_within_half_a_second(seed):
    pair = settled(seed)
    at_s = SETTLED_S + pair.random.uniform(0.0, 1.0)
    pair.at(at_s, lambda: pair.kill(0))
    pair.run(at_s + 5.0)
    (vehicle,) = pair.vehicles
    assert pair.active() == [1]
    seen = pair.services[1].peer.snapshot(pair.clock_of(1))
    assert (seen.sends, seen.other_state) == ("this", None)  # and not two that send
    assert gaps(vehicle, SETTLED_S, pair.now_s - 0.2) <= 0.5
    assert overlaps(vehicle) == []


@pytest.mark.parametrize("seed", range(20))
def test_by_the_fed_receiver_alone_it_takes_a_moment_longer(seed):
    pair = settled(seed, [Vehicle(4, passes_on=False)])
    at_s = SETTLED_S + pair.random.uniform(0.0, 1.0)
    pair.at(at_s, lambda: pair.kill(0))
    pair.run(at_s + 5.0)
    (vehicle,) = pair.vehicles
    assert gaps(vehicle, SETTLED_S, pair.now_s - 0.2) <= 0.8
    assert overlaps(vehicle) == []


@pytest.mark.parametrize("seed", range(40))
def test_one_that_was_stopped_sends_nothing_when_it_goes_on(seed):
    pair = settled(seed)
    stops_s = SETTLED_S + pair.random.uniform(0.0, 1.0)
    pair.at(stops_s, lambda: pair.stop(0))
    goes_on_s = stops_s + pair.random.choice([0.25, 0.4, 0.6, 1.0, 3.0, 20.0])
    pair.at(goes_on_s, lambda: pair.go_on(0))
    pair.run(goes_on_s + 3.0)
    (vehicle,) = pair.vehicles
    assert overlaps(vehicle, 30.0) == []
    assert len(pair.active()) == 1
    if goes_on_s - stops_s >= 0.6:
        assert pair.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
        assert all(index == 1 for t, index in vehicle.fed if t >= goes_on_s)


@pytest.mark.parametrize("passes_on", [True, False])
@pytest.mark.parametrize("seed", range(20))
def test_a_split_changes_nothing_while_the_vehicle_shows_who_feeds_it(seed, passes_on):
    pair = settled(seed, [Vehicle(4, passes_on=passes_on)])
    pair.split = [True, True]
    pair.run(SETTLED_S + 30.0)
    assert pair.states() == [StandbyState.ACTIVE, StandbyState.STANDBY]
    assert pair.services[1].peer.snapshot(pair.clock_of(1)).sends == "other"
    pair.split = [False, False]
    pair.run(SETTLED_S + 32.0)
    (vehicle,) = pair.vehicles
    assert all(index == 0 for _, index in vehicle.fed)
    assert gaps(vehicle, SETTLED_S, pair.now_s) <= 0.25


@pytest.mark.parametrize("cut", [(True, False), (False, True)])
def test_a_link_that_is_cut_in_one_direction_changes_nothing(cut):
    pair = settled(1)
    pair.split = list(cut)
    pair.run(SETTLED_S + 20.0)
    assert pair.states() == [StandbyState.ACTIVE, StandbyState.STANDBY]


def test_a_vehicle_that_shows_nothing_is_left_to_the_operator():
    pair = settled(1, [Vehicle(4, passes_on=False, reports=False)])
    pair.kill(0)
    pair.run(SETTLED_S + 20.0)
    peer = pair.services[1].peer
    assert pair.active() == []
    assert "take over" in peer.snapshot(pair.clock_of(1)).problem
    assert peer.order(StandbyOrder.TAKE_OVER, pair.clock_of(1)) is None
    pair.run(SETTLED_S + 22.0)
    assert pair.active() == [1]
    assert pair.vehicles[0].fed[-1][1] == 1


def test_a_gps_that_fails_long_after_the_active_one_died_is_aided():
    pair = settled(1, [Vehicle(4, needs_aid=False)])
    pair.kill(0)
    pair.run(SETTLED_S + 60.0)
    assert pair.states()[1] is StandbyState.STANDBY  # nothing to do: nothing changes
    pair.vehicles[0].needs_aid = True
    pair.run(SETTLED_S + 62.0)
    first_s, sender = pair.vehicles[0].fed[0]
    assert sender == 1
    assert first_s <= SETTLED_S + 60.0 + 1.3


def test_a_gps_that_fails_in_a_split_is_aided_by_the_active_one_alone():
    for seed in range(20):
        pair = settled(seed, [Vehicle(4, needs_aid=False)])
        pair.split = [True, True]
        pair.run(SETTLED_S + 20.0)
        pair.vehicles[0].needs_aid = True
        pair.run(SETTLED_S + 40.0)
        assert {index for _, index in pair.vehicles[0].fed} == {0}


@pytest.mark.parametrize("seed", range(10))
def test_one_that_returns_is_passive_until_it_is_told(seed):
    pair = settled(seed)
    pair.kill(0)
    pair.run(SETTLED_S + 3.0)
    pair.start(0)
    pair.run(SETTLED_S + 8.0)
    assert pair.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
    peer = pair.services[0].peer
    assert peer.order(StandbyOrder.STAND_BY, pair.clock_of(0)) is None
    pair.kill(1)
    pair.run(SETTLED_S + 12.0)
    assert pair.active() == [0]
    assert overlaps(pair.vehicles[0]) == []


@pytest.mark.parametrize("seed", range(30))
def test_one_that_returns_to_a_slow_one_is_passive_all_the_same(seed):
    pair = settled(seed)
    pair.kill(0)
    pair.run(SETTLED_S + 3.0)
    pair.services[1].pause_s = 0.8
    pair.start(0)
    pair.run(SETTLED_S + 12.0)
    pair.services[1].pause_s = 0.0
    pair.run(SETTLED_S + 14.0)
    assert pair.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
    assert overlaps(pair.vehicles[0]) == []


@pytest.mark.parametrize("by", [0, 1])
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_change_on_an_operators_word_leaves_no_gap(by, loss):
    for seed in range(10):
        pair = settled(seed)
        pair.loss = loss
        pair.run(SETTLED_S + 1.0)
        order = StandbyOrder.RELEASE if by == 0 else StandbyOrder.TAKE_OVER
        told_s = pair.now_s
        assert pair.services[by].peer.order(order, pair.clock_of(by)) is None
        pair.run(told_s + 6.0)
        assert len(pair.active()) == 1
        assert overlaps(pair.vehicles[0]) == []
        if not loss:
            assert pair.active() == [1]
            assert gaps(pair.vehicles[0], told_s, pair.now_s - 0.2) <= 0.35


def test_taking_over_what_the_other_one_visibly_feeds_is_refused():
    pair = settled(1)
    pair.split = [True, True]
    pair.run(SETTLED_S + 3.0)
    refusal = pair.services[1].peer.order(StandbyOrder.TAKE_OVER, pair.clock_of(1))
    assert refusal is not None
    assert "still fed" in refusal.text
    assert pair.active() == [0]


def test_two_that_are_both_to_be_active_agree_on_one():
    for seed in range(20):
        pair = TwoServices(seed, roles=(True, True))
        pair.start(0)
        pair.run(pair.random.uniform(0.0, 0.5))
        pair.start(1)
        pair.run(10.0)
        assert len(pair.active()) == 1
        assert overlaps(pair.vehicles[0]) == []


FAULTS = ("kill", "stop", "split", "return", "slow")


def fault(pair: TwoServices, kind: str, at_s: float, draw: random.Random) -> float:
    """Let one fault come at a time, and pass; return when it has passed."""
    lasts_s = draw.choice([0.15, 0.25, 0.35, 0.5, 1.0, 3.0, 6.0])
    index = draw.choice([0, 0, 1])
    ends_s = at_s + lasts_s
    match kind:
        case "kill":
            pair.at(at_s, lambda: pair.kill(index))
        case "stop":
            pair.at(at_s, lambda: pair.stop(index))
            pair.at(ends_s, lambda: pair.go_on(index))
        case "split":
            ways = draw.choice([[True, True], [True, False], [False, True]])
            pair.at(at_s, lambda: pair.split.__setitem__(slice(None), ways))
            pair.at(ends_s, lambda: pair.split.__setitem__(slice(None), [False, False]))
        case "return":
            pair.at(at_s, lambda: pair.kill(index))
            pair.at(ends_s, lambda: pair.start(index))
        case "slow":
            pair.at(at_s, lambda: setattr(pair.services[index], "pause_s", draw.choice([0.15, 0.25, 0.4, 0.8])))
            pair.at(ends_s, lambda: setattr(pair.services[index], "pause_s", 0.0))
    return ends_s


@pytest.mark.parametrize("kind", FAULTS)
def test_no_fault_makes_two_send(kind):
    """Two hundred random faults and more, fifty of each kind, on a link that loses and delays messages as well."""
    for seed in range(50):
        draw = random.Random(seed)
        pair = settled(seed, [Vehicle(4), Vehicle(5, needs_aid=draw.random() < 0.5)])
        pair.loss, pair.delay_s = draw.choice([0.0, 0.05, 0.2]), draw.choice([0.001, 0.01, 0.05])
        begins_s = SETTLED_S + draw.uniform(0.5, 1.5)
        ends_s = fault(pair, kind, begins_s, draw)
        pair.at(draw.uniform(SETTLED_S, ends_s + 2.0), lambda s=pair: setattr(s.vehicles[1], "needs_aid", True))
        pair.run(ends_s + 8.0)
        for vehicle in pair.vehicles:
            assert overlaps(vehicle) == [], (kind, seed, vehicle.sysid)
        assert len(pair.active()) == 1, (kind, seed, pair.states())
        # At the longest: one that returns before the other one has taken over listens for a second.
        assert gaps(pair.vehicles[0], SETTLED_S, pair.now_s - 0.3) <= 1.5, (kind, seed)


def test_several_faults_at_once_make_two_send_for_a_moment_at_most():
    """A split and a stop together leave nothing to tell by but the vehicle: what both send ends when it has shown that."""
    longest_s, twice = 0.0, 0
    for seed in range(200):
        draw = random.Random(seed)
        pair = settled(seed)
        pair.loss = draw.choice([0.0, 0.2])
        ends_s = max(fault(pair, draw.choice(FAULTS), SETTLED_S + draw.uniform(0.5, 6.0), draw) for _ in range(4))
        pair.run(ends_s + 10.0)
        found = overlaps(pair.vehicles[0])
        twice += bool(found)
        longest_s = max([longest_s, *(lasted_s for _, lasted_s in found)])
    assert longest_s <= 0.4
    assert twice <= 2


def test_why_it_is_in_its_state_is_told():
    pair = settled(1)
    pair.stop(0)
    pair.run(SETTLED_S + 2.0)
    pair.go_on(0)
    pair.run(SETTLED_S + 4.0)
    snapshots = [service.peer.snapshot(pair.clock_of(index)) for index, service in enumerate(pair.services)]
    assert pair.services[0].peer.reason.reason is StandbyReason.OTHER_IS_ACTIVE
    assert [snapshot.sends for snapshot in snapshots] == ["other", "this"]
    assert snapshots[1].reason == StandbyReason.TOOK_OVER.wording
    assert "does not take over by itself" in snapshots[1].problem


def test_one_that_returns_and_hears_no_sign_of_life_is_passive_because_the_vehicle_is_fed():
    pair = settled(1)
    pair.kill(0)
    pair.run(SETTLED_S + 2.0)
    pair.split = [False, True]
    pair.start(0)
    pair.run(SETTLED_S + 4.0)
    assert pair.states() == [StandbyState.PASSIVE, StandbyState.ACTIVE]
    assert pair.services[0].peer.reason.reason is StandbyReason.OTHER_FEEDS
    assert overlaps(pair.vehicles[0]) == []


def test_one_that_took_over_by_mistake_stands_back_as_soon_as_it_sees_the_other_ones_stream():
    """The vehicle ceases to pass on and the link is cut in the same moment: all that there is to tell by says the wrong thing."""
    for seed in range(20):
        pair = settled(seed, [Vehicle(4, reports=False)])
        (vehicle,) = pair.vehicles
        vehicle.passes_on, pair.split = False, [True, True]
        pair.run(SETTLED_S + 2.0)
        assert pair.active() == [0, 1]
        vehicle.passes_on = True
        pair.run(SETTLED_S + 3.0)
        assert pair.active() == [0]
        assert max(t for t, index in vehicle.fed if index == 1) < SETTLED_S + 2.4
        pair.run(SETTLED_S + 20.0)
        assert pair.active() == [0]
