"""A full route table: who makes room, who is kept, and that a known vehicle comes back in."""

import pytest
from heard_routes import HERE, LINK, THERE, Ears

from gcs_coloc.links.base import Route
from gcs_coloc.links.routes import PROVEN_AFTER_S


def known_for_some_time(ears: Ears, *sysids: int) -> None:
    """Vehicles that have been heard for as long as proves them, each at a port of its own."""
    for _ in range(round(PROVEN_AFTER_S) + 2):
        for sysid in sysids:
            ears.hears(sysid, ("10.0.0.1", 14550 + sysid))
        ears.now_s += 1.0


def test_flood_of_made_up_senders_is_bounded_and_pushes_out_no_live_vehicle():
    ears = Ears(max_components=50, max_addresses=20)
    ears.hears(1, HERE)
    for number in range(2000):
        ears.hears(2 + number % 250, ("6.6.6.6", number), compid=number % 256, autopilot=number % 2 == 0)
        ears.now_s += 0.001
    assert len(ears.table._components) <= 50
    assert len(ears.table._autopilots_at) <= 20
    assert ears.table.counts["route_table_full"] > 0
    assert ears.hears(1, HERE)
    assert ears.route(1) == Route(LINK, HERE)


def test_table_has_room_again_when_the_flood_is_over():
    ears = Ears(max_components=10, max_addresses=10)
    for number in range(100):
        ears.hears(100 + number, ("6.6.6.6", number))
    assert not ears.hears(1, HERE)
    ears.now_s += 61.0
    assert ears.hears(1, HERE)
    assert ears.route(1) == Route(LINK, HERE)


def test_what_fell_silent_makes_room_although_it_came_after_a_lively_one():
    ears = Ears(max_components=3, max_addresses=3)
    ears.hears(1, HERE)
    for number in (2, 3):
        ears.hears(number, ("10.0.0.9", number))
    for _ in range(31):
        ears.now_s += 2.0
        ears.hears(1, HERE)
    assert ears.hears(4, THERE)
    assert ears.route(4) == Route(LINK, THERE)
    assert ears.route(1) == Route(LINK, HERE)


def test_a_flood_of_addresses_keeps_no_known_vehicle_out_after_its_port_changed():
    ears = Ears(max_addresses=256)
    for _ in range(12):
        ears.hears(1, HERE)
        ears.now_s += 1.0
    for number in range(255):
        assert ears.hears(2 + number % 250, ("6.6.6.6", number)) or number >= 250
    ears.now_s += 5.1
    for number in range(255):
        ears.hears(2 + number % 250, ("6.6.6.7", number))
    moved = ("10.0.0.1", 14999)
    assert ears.hears(1, moved)
    assert ears.route(1) == Route(LINK, moved)
    assert not ears.hears(252, ("6.6.6.8", 1))  # a newcomer still waits until somebody is silent


@pytest.mark.parametrize("port", [14551, 14999])
@pytest.mark.parametrize("companions_elsewhere", [True, False])
def test_a_known_vehicle_that_was_evicted_while_silent_comes_back_in(port, companions_elsewhere):
    ears = Ears(max_components=20, max_addresses=20, companions_elsewhere=companions_elsewhere)
    known_for_some_time(ears, 1)
    ears.now_s += 61.0
    for number in range(40):
        ears.hears(2 + number, ("6.6.6.6", number))
    assert ears.table.counts["route_table_full"] > 0
    assert not ears.table.reach(1, 1) or not companions_elsewhere
    address = ("10.0.0.1", port)
    assert ears.hears(1, address)
    assert ears.hears(1, address, autopilot=False)
    assert ears.route(1) == Route(LINK, address)
    assert not ears.hears(60, ("6.6.6.7", 1))


def test_the_silent_and_unproven_make_room_before_the_silent_and_proven():
    ears = Ears(max_components=3, max_addresses=3)
    known_for_some_time(ears, 1, 2)
    ears.hears(3, THERE)
    ears.now_s += 61.0
    assert ears.hears(4, ("10.0.0.4", 1))
    assert set(ears.table._components) == {(1, 0), (2, 0), (4, 0)}
    assert {sysid for there in ears.table._autopilots_at.values() for sysid in there} == {1, 2, 4}


def test_nobody_gets_the_room_of_a_known_vehicle_by_using_its_system_id():
    """With companions at addresses of their own a component of any system may be anywhere."""
    ears = Ears(max_components=3, max_addresses=3, companions_elsewhere=True)
    known_for_some_time(ears, 1)
    for sysid in (2, 3):
        ears.hears(sysid, ("10.0.0.2", sysid))
    assert not ears.hears(1, ("6.6.6.6", 1), compid=66, autopilot=False)
    assert ears.hears(1, ("10.0.0.1", 14551), compid=66, autopilot=False)
