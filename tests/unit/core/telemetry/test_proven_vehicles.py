"""Who is proven on an unsigned link: by being there first, by an address of its own, by being measured; and who makes room."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, fly, settings, telemetry

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.core.messages.control import RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat
from gcs_coloc.core.telemetry.proven_vehicles import FOUNDING_S, SILENT_S, STEADY_S, ProvenVehicles
from gcs_coloc.core.telemetry.reported_state import ReportedState


class Fleet:
    """Vehicles by system id with the addresses that they are heard from, one look after the other."""

    def __init__(self) -> None:
        self.proven = ProvenVehicles()
        self.states: dict[int, ReportedState] = {}
        self.notices: list[str] = []

    def hear(self, at_s: float, *addresses: tuple[int, ...], vouched: tuple[int, ...] = ()) -> None:
        """Hear the vehicles of each address, and review all."""
        for there in addresses:
            for sysid in there:
                if sysid not in self.states:
                    self.states[sysid] = ReportedState(sysid, at_s, at_s)
                    self.proven.add(sysid, at_s)
                state = self.states[sysid]
                self.proven.update(state, at_s)
                state.last_heard_s = state.route_at_s = at_s
                state.shared_with = tuple(other for other in there if other != sysid)
                state.blocked = RouteBlock.SHARED_ADDRESS if state.shared_with else None
        self.notices += [n.text for n in self.proven.review(tuple(self.states.values()), vouched, at_s)]

    def hear_until(self, from_s: float, to_s: float, *addresses: tuple[int, ...]) -> None:
        for step in range(round(from_s), round(to_s) + 1):
            self.hear(float(step), *addresses)

    @property
    def all_proven(self) -> set[int]:
        return {sysid for sysid in self.states if self.proven.is_proven(sysid)}


def place(sysid: int, at_s: float, east_m: float) -> PositionMeasurement:
    return PositionMeasurement(sysid, at_s, at_s, (east_m, 0.0, 0.0), 1.0, 1.0, (0.0, 0.0, 0.0))


def measured(peer: int, newcomer: int, at_s: float, range_m: float) -> RangeMeasurement:
    return RangeMeasurement(peer, newcomer, at_s, at_s, range_m, 1.0)


def test_a_fleet_behind_one_address_is_proven_from_its_beginning():
    fleet = Fleet()
    fleet.hear_until(0, 20, (1, 2, 3, 4))
    assert fleet.all_proven == {1, 2, 3, 4}
    assert not fleet.notices


def test_of_who_is_there_at_the_beginning_those_at_one_address_are_not_proven_beside_those_alone():
    fleet = Fleet()
    fleet.hear_until(0, 20, (1,), (2,), (11, 12, 13))
    assert fleet.all_proven == {1, 2}


def test_a_newcomer_with_an_address_of_its_own_is_proven_after_three_seconds():
    fleet = Fleet()
    fleet.hear_until(0, 20, (1,), (2,))
    fleet.hear(21.0, (1,), (2,), (3,))
    assert 3 not in fleet.all_proven
    fleet.hear_until(22, 21 + STEADY_S, (1,), (2,), (3,))
    assert 3 in fleet.all_proven


def test_newcomers_at_a_shared_address_are_not_and_the_operator_is_told_once_what_to_do():
    fleet = Fleet()
    fleet.hear_until(0, 20, (1, 2, 3))
    fleet.hear_until(21, 90, (1, 2, 3, 11))
    assert fleet.all_proven == {1, 2, 3}
    assert len(fleet.notices) == 1
    assert "declare its GPS healthy" in fleet.notices[0]
    fleet.hear(91.0, (1, 2, 3, 11), vouched=(11,))
    assert 11 in fleet.all_proven


@pytest.mark.parametrize(
    ("measuring", "range_m", "proven"),
    [((1, 2), 500.0, True), ((1,), 500.0, False), ((1, 2), 530.0, False), ((11, 12), 500.0, False)],
)
def test_it_is_proven_by_two_known_vehicles_that_measure_it_where_it_says_it_is(measuring, range_m, proven):
    fleet = Fleet()
    fleet.hear_until(0, 20, (1, 2, 3))
    for step in range(21, 30):
        at_s = float(step)
        fleet.hear(at_s, (1, 2, 3, 11, 12))
        for peer in measuring:
            if peer != 11:
                fleet.proven.add_range(measured(peer, 11, at_s, range_m), place(peer, at_s, 0.0), place(11, at_s, 500.0))
    assert fleet.proven.is_proven(11) is proven


def test_one_without_a_position_of_its_own_is_proven_by_being_measured():
    fleet = Fleet()
    fleet.hear_until(0, 20, (1, 2, 3))
    for step in range(21, 30):
        fleet.hear(float(step), (1, 2, 3, 4))
        for peer in (1, 2):
            fleet.proven.add_range(measured(peer, 4, float(step), 300.0), None, None)
    assert fleet.proven.is_proven(4)


def test_a_vehicle_that_was_silent_is_known_again_alone_or_among_its_companions_but_not_among_strangers():
    for before, after, proven in (
        ((4,), (4,), True),
        ((1, 2, 3, 4), (1, 2, 3, 4), True),
        ((1, 2, 3, 4), (4,), True),
        ((4,), (4, 11, 12), False),
    ):
        fleet = Fleet()
        fleet.hear_until(0, 20, before)
        fleet.hear_until(20 + SILENT_S + 1, 30 + SILENT_S, after)
        assert fleet.proven.is_proven(4) is proven


def test_a_silent_vehicle_counts_again_only_when_the_links_tell_where_it_is():
    fleet = Fleet()
    fleet.hear_until(0, 20, (4,))
    state = fleet.states[4]
    fleet.proven.update(state, 40.0)
    state.last_heard_s = 40.0
    fleet.proven.review([state], (), 40.2)
    assert not fleet.proven.is_proven(4)
    fleet.hear(41.0, (4,))
    assert fleet.proven.is_proven(4)


def shared(engine: Engine, sysids: range, at_s: float) -> None:
    for sysid in sysids:
        engine.receive(Heartbeat(sysid, at_s, Autopilot.ARDUPILOT, False, winged=False))
        engine.receive(RouteReport(sysid, at_s, RouteBlock.SHARED_ADDRESS, tuple(other for other in sysids if other != sysid)))


def test_a_flood_of_forged_vehicles_keeps_neither_a_known_nor_a_new_one_out():
    engine = Engine(StraightLine(), settings(max_vehicles=8))
    fly(engine, 0.0, FOUNDING_S + 2.0)
    fly(engine, 12.0, 14.0, sysids=(1, 2, 3))  # 4 falls silent
    for at_s in (14.0, 15.0, 30.0, 31.0):
        shared(engine, range(100, 140), at_s)
        fly(engine, at_s, at_s + 1.0, sysids=(1, 2, 3))
    assert {1, 2, 3, 4} <= set(engine.sysids())
    assert len(engine.sysids()) == 8
    for message in telemetry(5, 40.0):
        engine.receive(message)
    assert {1, 2, 3, 4, 5} <= set(engine.sysids())
    assert len(engine.sysids()) == 8
