"""Nothing may be sent where the wrong autopilot would take it."""

import pytest
from heard_routes import HERE, LINK, THERE, Ears

from gcs_coloc.core.messages.control import RouteBlock, RouteReport
from gcs_coloc.links.base import Route
from gcs_coloc.links.routes import Blocked


@pytest.fixture
def ears():
    return Ears()


def test_vehicle_is_reached_where_its_heartbeat_comes_from(ears):
    assert ears.hears(1, HERE)
    assert ears.hears(2, THERE)
    assert ears.route(1) == Route(LINK, HERE)
    assert ears.route(2) == Route(LINK, THERE)


def test_vehicle_never_heard_is_blocked_in_words(ears):
    assert ears.route(7) == Blocked(RouteBlock.NO_HEARTBEAT)


def test_other_messages_of_a_vehicle_give_no_route(ears):
    assert ears.hears(1, HERE, autopilot=False)
    assert isinstance(ears.route(1), Blocked)


def test_companion_computer_elsewhere_is_heard_where_that_is_allowed_and_does_not_move_the_route():
    ears = Ears(companions_elsewhere=True)
    ears.hears(1, HERE)
    assert ears.hears(1, THERE, compid=191, autopilot=False)
    assert ears.route(1) == Route(LINK, HERE)


@pytest.mark.parametrize("autopilot", [True, False])
def test_second_address_of_a_live_sender_is_refused(ears, autopilot):
    ears.hears(1, HERE)
    ears.now_s += 4.9
    assert not ears.hears(1, THERE, autopilot=autopilot)
    assert ears.table.counts["address_conflict"] == 1
    assert ears.route(1) == Route(LINK, HERE)


def test_second_autopilot_of_one_vehicle_at_another_address_is_refused(ears):
    ears.hears(1, HERE, compid=1)
    assert not ears.hears(1, THERE, compid=2)
    assert ears.route(1) == Route(LINK, HERE)


def test_companion_computer_elsewhere_is_refused_unless_that_is_allowed(ears):
    ears.hears(1, HERE)
    assert not ears.hears(1, THERE, compid=191, autopilot=False)
    assert ears.hears(1, HERE, compid=191, autopilot=False)
    assert ears.table.counts["address_conflict"] == 1


def test_who_came_first_without_being_an_autopilot_keeps_the_autopilot_not_out(ears):
    ears.hears(1, THERE, compid=1, autopilot=False)
    assert ears.hears(1, HERE)
    assert not ears.hears(1, THERE, compid=1, autopilot=False)
    assert ears.route(1) == Route(LINK, HERE)


def test_ground_stations_may_share_a_system_id(ears):
    assert ears.hears(255, HERE, compid=190, autopilot=False)
    assert ears.hears(255, THERE, compid=230, autopilot=False)
    assert not ears.hears(255, THERE, compid=190, autopilot=False)


def test_any_frame_of_a_vehicle_keeps_its_autopilots_address(ears):
    ears.hears(1, HERE)
    for _ in range(4):
        ears.now_s += 4.0
        assert ears.hears(1, HERE, autopilot=False)
        assert not ears.hears(1, THERE)


@pytest.mark.parametrize(("rebind_after_s", "roams"), [(59.0, True), (61.0, False), (float("inf"), False)])
def test_how_soon_a_silent_vehicle_may_roam_is_a_setting(rebind_after_s, roams):
    ears = Ears(rebind_after_s=rebind_after_s)
    ears.hears(1, HERE)
    ears.now_s += 60.0
    assert ears.hears(1, THERE) is roams


class Named:
    name = "udpin:0.0.0.0:14550"


def test_a_second_address_of_a_system_id_is_told_with_both_and_not_too_often(ears):
    ears.hears(1, HERE, link=Named)
    ears.hears(2, HERE, link=Named)
    for _ in range(1000):
        ears.hears(1, THERE, link=Named)
    ((sysid, text),) = ears.table.conflicts.pending_warnings(ears.now_s)
    assert sysid == 1
    for part in ("10.0.0.1:14550 on udpin:0.0.0.0:14550", "10.0.0.2:14550", "1000 times", "SYSID_THISMAV"):
        assert part in text
    assert ears.table.conflicts.pending_warnings(ears.now_s) == []
    ears.hears(1, THERE, link=Named)
    assert ears.table.conflicts.pending_warnings(ears.now_s + 9.9) == []
    assert "1 times" in ears.table.conflicts.pending_warnings(ears.now_s + 10.0)[0][1]


def test_a_vehicle_that_moves_is_told(ears):
    ears.hears(1, HERE, link=Named)
    ears.now_s += 6.0
    ears.hears(1, THERE, link=Named)
    ((sysid, text),) = ears.table.conflicts.pending_warnings(ears.now_s)
    assert (sysid, "10.0.0.2:14550" in text, "10.0.0.1:14550" in text) == (1, True, True)


def test_same_address_on_another_link_is_another_address(ears):
    ears.hears(1, HERE)
    assert not ears.hears(1, HERE, link="another link")


def test_silent_sender_may_roam(ears):
    ears.hears(1, HERE)
    ears.now_s += 5.0
    assert ears.hears(1, THERE)
    assert ears.route(1) == Route(LINK, THERE)


def test_refused_frames_do_not_keep_a_pin_alive(ears):
    ears.hears(1, HERE)
    for _ in range(4):
        ears.now_s += 1.5
        accepted = ears.hears(1, THERE)
    assert accepted


def test_two_autopilots_at_one_address_get_nothing_and_the_operator_is_told_what_to_do(ears):
    ears.hears(1, HERE)
    ears.hears(2, HERE)
    for sysid, other in ((1, 2), (2, 1)):
        blocked = ears.route(sysid)
        assert blocked == Blocked(RouteBlock.SHARED_ADDRESS, (other,), blocked.route)
        wording = RouteReport(sysid, ears.now_s, blocked.reason, blocked.shared_with).wording
        assert wording is not None
        for words in (f"vehicles {other} and {sysid}", "own UDP stream", "--link"):
            assert words in wording


def test_two_vehicles_on_one_serial_link_get_nothing(ears):
    ears.hears(1, ("serial", "/dev/ttyUSB0"))
    ears.hears(2, ("serial", "/dev/ttyUSB0"))
    assert isinstance(ears.route(2), Blocked)


def test_vehicle_without_autopilot_at_the_same_address_blocks_nothing(ears):
    """A ground station or a companion computer beside the vehicle does not take GPS_INPUT."""
    ears.hears(1, HERE)
    ears.hears(255, HERE, autopilot=False)
    assert ears.route(1) == Route(LINK, HERE)


def test_address_stays_shared_for_a_while_after_the_other_fell_silent(ears):
    """It may still hear us when we do not hear it."""
    ears.hears(2, HERE)
    ears.now_s += 59.0
    ears.hears(1, HERE)
    assert isinstance(ears.route(1), Blocked)
    ears.now_s += 2.0
    assert ears.route(1) == Route(LINK, HERE)


def test_vehicle_heard_directly_and_over_a_router_blocks_the_router(ears):
    """Vehicle 1 is refused at the router's address, but would take what is sent there to vehicle 2."""
    ears.hears(1, HERE)
    assert not ears.hears(1, THERE)
    assert ears.hears(2, THERE)
    assert ears.route(1) == Route(LINK, HERE)
    assert isinstance(ears.route(2), Blocked)


def test_a_vehicle_is_reached_for_others_even_where_it_shares_its_address(ears):
    ears.hears(1, HERE)
    ears.hears(2, HERE)
    assert isinstance(ears.route(1), Blocked)
    assert ears.table.reach(1, 0) == ears.table.reach(1, 190) == (Route(LINK, HERE),)
    assert ears.table.vehicles() == {Route(LINK, HERE): {1, 2}}


def test_who_was_not_heard_is_reached_nowhere(ears):
    ears.hears(1, HERE)
    assert ears.table.reach(2, 0) == ()
    assert not ears.table.is_vehicle(2)
    assert ears.table.is_vehicle(1)


def test_a_system_without_an_autopilot_is_reached_but_is_no_vehicle(ears):
    ears.hears(100, THERE, compid=25, autopilot=False)
    assert ears.table.reach(100, 0) == (Route(LINK, THERE),)
    assert ears.table.vehicles() == {}


def test_a_companion_elsewhere_is_reached_there_and_the_whole_vehicle_at_both():
    ears = Ears(companions_elsewhere=True)
    ears.hears(1, HERE)
    ears.hears(1, THERE, compid=191, autopilot=False)
    assert ears.table.reach(1, 191) == (Route(LINK, THERE),)
    assert ears.table.reach(1, 1) == (Route(LINK, HERE),)
    assert set(ears.table.reach(1, 0)) == set(ears.table.reach(1, 154)) == {Route(LINK, HERE), Route(LINK, THERE)}
    assert ears.table.vehicles() == {Route(LINK, HERE): {1}, Route(LINK, THERE): {1}}


def test_a_frame_from_another_address_than_its_vehicles_is_away_from_home_until_the_vehicle_may_roam(ears):
    ears.hears(1, HERE)
    assert ears.table.comes_from_its_binding(1, 1, LINK, HERE, ears.now_s)
    assert not ears.table.comes_from_its_binding(1, 154, LINK, THERE, ears.now_s)
    assert ears.table.comes_from_its_binding(2, 1, LINK, THERE, ears.now_s)
    assert ears.table.comes_from_its_binding(1, 154, LINK, THERE, ears.now_s + 5.0)
    assert not ears.table.counts


def test_of_ground_stations_with_one_system_id_each_component_has_a_home_of_its_own(ears):
    ears.hears(255, HERE, compid=190, autopilot=False)
    assert not ears.table.comes_from_its_binding(255, 190, LINK, THERE, ears.now_s)
    assert ears.table.comes_from_its_binding(255, 195, LINK, THERE, ears.now_s)


def test_who_is_reached_at_an_address_is_known_for_a_minute_after_it_was_heard(ears):
    ears.hears(1, HERE)
    ears.now_s += 30.0
    ears.hears(2, HERE)
    ears.now_s += 29.0
    assert ears.table.autopilots_at(LINK, HERE, ears.now_s) == (1, 2)
    ears.now_s += 2.0
    assert ears.table.autopilots_at(LINK, HERE, ears.now_s) == (2,)
    assert ears.table.autopilots_at(LINK, THERE, ears.now_s) == ()


def test_a_ground_station_that_several_vehicles_forward_is_no_pretender(ears):
    for address in (HERE, THERE, HERE, THERE):
        assert ears.hears(255, address, compid=190, autopilot=False, other=True)
        assert ears.hears(255, address, compid=190, autopilot=False)
    assert ears.table.counts["address_conflict"] == 0
    assert ears.table.conflicts.pending_warnings(ears.now_s) == []


def test_a_component_of_a_vehicle_is_bound_whatever_it_says_to_be(ears):
    assert ears.hears(7, THERE, compid=190, autopilot=False, other=True)
    assert ears.hears(7, HERE)
    assert not ears.hears(7, THERE, compid=190, autopilot=False, other=True)
    assert not ears.hears(7, THERE, compid=1, autopilot=False)
    assert ears.table.counts["address_conflict"] == 2


def test_a_second_sender_that_is_no_vehicle_yet_is_refused_without_a_word(ears):
    assert ears.hears(9, HERE, autopilot=False)
    assert not ears.hears(9, THERE, autopilot=False)
    assert ears.table.conflicts.pending_warnings(ears.now_s) == []
