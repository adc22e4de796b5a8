"""Readiness through the engine with the fleet filter: what each geometry gives, and when a change of it counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.readiness.vehicle_readiness import LimitingReason, ReadinessState
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
from tests.engine_flights import StraightLine
from tests.ready_fleet import AROUND, RANGED, ReadyFleet, abreast

SETTLED_S = 12.0


def told(fleet: ReadyFleet, until_s: float = SETTLED_S):
    readiness = fleet.fly(until_s)
    assert readiness is not None
    return readiness


@pytest.mark.parametrize(
    ("peers", "state", "reason"),
    [
        (0, ReadinessState.NOT_READY, LimitingReason.NO_PEER.code),
        (1, ReadinessState.NOT_READY, LimitingReason.ONE_PEER.code),
        (2, ReadinessState.DEGRADED, LimitingReason.NOT_TESTED.code),
        (3, ReadinessState.READY, None),
        (4, ReadinessState.READY, None),
    ],
)
def test_each_peer_more_makes_a_vehicle_readier(peers: int, state: ReadinessState, reason: str | None) -> None:
    readiness = told(ReadyFleet(abreast(*AROUND[:peers])))
    assert (readiness.state, readiness.reason, readiness.peers) == (state, reason, peers)


def test_peers_in_one_line_are_named() -> None:
    readiness = told(ReadyFleet(abreast((500.0, 0.0), (900.0, 0.0), (-700.0, 0.0))))
    assert readiness.state is ReadinessState.NOT_READY
    assert readiness.reason == LimitingReason.IN_LINE.code
    assert readiness.text.startswith("peers 2, 3 and 4 in one line with it")


def test_distance_costs_nothing_while_the_ranges_arrive_and_all_once_they_do_not() -> None:
    far = abreast(*((20.0 * e, 20.0 * n) for e, n in AROUND))
    near, distant = told(ReadyFleet(abreast(*AROUND))), told(ReadyFleet(far))
    assert distant.state is ReadinessState.READY
    assert distant.bound_95_m == pytest.approx(near.bound_95_m, rel=0.05)
    assert told(ReadyFleet(far, max_range_m=5000.0)).reason == LimitingReason.NO_PEER.code


def test_a_bound_beyond_the_alert_limit_is_not_ready() -> None:
    settings = EngineSettings(request_streams=False, aiding=AidingSettings(alert_limit_m=20.0))
    readiness = told(ReadyFleet(abreast(*AROUND), settings=settings))
    assert readiness.state is ReadinessState.NOT_READY
    assert readiness.reason == LimitingReason.BEYOND_ALERT_LIMIT.code
    assert readiness.hpl_m is not None
    assert readiness.hpl_m > 20.0
    assert "beyond the alert limit of 20 m" in readiness.text


def test_worse_receivers_and_worse_ranges_are_in_the_bound() -> None:
    good, coarse_gps, coarse_ranges = (
        told(ReadyFleet(abreast(*AROUND), **changes)) for changes in ({}, {"h_acc_m": 3.0}, {"range_sigma_m": 6.0})
    )
    assert good.bound_95_m is not None
    assert good.hpl_m is not None
    for worse in (coarse_gps, coarse_ranges):
        assert worse.bound_95_m is not None
        assert worse.hpl_m is not None
        assert worse.bound_95_m > 1.3 * good.bound_95_m
        assert worse.hpl_m > good.hpl_m


def test_how_well_a_height_is_known_without_gps_is_in_the_bound() -> None:
    peers = {
        sysid: replace(flying, place=(*flying.place[:2], flying.place[2] + 300.0))
        for sysid, flying in abreast(*AROUND[:2]).items()
    }
    peers[RANGED] = abreast()[RANGED]
    bounds_m = []
    for sigma_m in (2.0, 30.0):
        settings = EngineSettings(request_streams=False, measurements=MeasurementSettings(altitude_sigma_m=sigma_m))
        bounds_m.append(told(ReadyFleet(peers, settings=settings)).bound_95_m)
    assert bounds_m[1] > 1.2 * bounds_m[0]


def test_half_a_minute_ahead_the_geometry_is_another_one() -> None:
    """The peers' line is crossed at 42 s: 12 s after the first predictions, within the horizon of the later ones."""
    peers = {sysid: flying for sysid, flying in abreast((600.0, 800.0), (-500.0, 800.0)).items() if sysid != RANGED}
    ways = {RANGED: abreast()[RANGED], **{sysid: type(flying)(flying.place) for sysid, flying in peers.items()}}
    fleet = ReadyFleet(ways)
    readiness = told(fleet, 10.0)
    assert readiness.hdop_now is not None
    assert readiness.hdop is not None
    assert readiness.hdop > 2.0 * readiness.hdop_now


def test_the_size_of_the_bound_is_told_once_the_geometry_was_steady_for_a_minute() -> None:
    fleet = ReadyFleet(abreast(*AROUND))
    assert not told(fleet, 40.0).is_told
    assert told(fleet, 75.0).is_told


def test_only_a_healthy_vehicle_has_a_readiness() -> None:
    fleet = ReadyFleet(abreast(*AROUND))
    assert told(fleet).state is ReadinessState.READY
    fleet.fix_types[RANGED] = 1
    assert fleet.fly(25.0) is None
    assert all(v.readiness is not None for v in fleet.engine.snapshot(25.0).vehicles if v.sysid != RANGED)


def test_a_peer_whose_gps_has_failed_is_none() -> None:
    fleet = ReadyFleet(abreast(*AROUND))
    assert told(fleet).peers == 4
    fleet.fix_types[2] = 1
    assert told(fleet, 45.0).peers == 3


def test_what_could_not_be_aided_is_not_ready() -> None:
    fleet = ReadyFleet(abreast(*AROUND))
    told(fleet, 8.0)
    fleet.blocked = True
    readiness = told(fleet, 40.0)
    assert readiness.state is ReadinessState.NOT_READY
    assert readiness.reason == LimitingReason.NOT_AIDED.code
    assert readiness.text.startswith("it could not be aided: ")


@pytest.mark.parametrize("estimator", [QuZhangFilter(), StraightLine()])
def test_an_estimator_that_predicts_nothing_leaves_it_unknown(estimator) -> None:
    readiness = told(ReadyFleet(abreast(*AROUND), estimator=estimator))
    assert readiness.state is ReadinessState.UNKNOWN
    assert readiness.reason == LimitingReason.NOT_PREDICTED.code
    assert estimator.name in readiness.text


class Raising(StraightLine):
    def predict_loss(self, *_: object) -> list:
        raise ZeroDivisionError


def test_an_estimator_that_fails_to_predict_is_told_once_and_leaves_it_unknown() -> None:
    fleet = ReadyFleet(abreast(*AROUND), estimator=Raising())
    assert told(fleet, 40.0).state is ReadinessState.UNKNOWN
    assert fleet.engine.snapshot(40.0).estimator_counts["raised an exception"] > 1
    assert sum("raised an exception" in notice for notice in fleet.notices) == 1


def test_readiness_is_lost_in_flight_and_only_what_lasts_counts() -> None:
    fleet = ReadyFleet(abreast(*AROUND))
    assert told(fleet, 16.0).state is ReadinessState.READY
    fleet.ranged = []
    lost = told(fleet, 45.0)
    assert lost.state is ReadinessState.NOT_READY
    assert lost.is_lost
    fleet.ranged = [2, 3, 4, 5]
    assert told(fleet, 55.0).is_lost
    regained = told(fleet, 90.0)
    assert regained.state is ReadinessState.READY
    assert not regained.is_lost
    changes = [a.state for a, b in zip(fleet.seen, fleet.seen[1:], strict=False) if a.state is not b.state]
    assert len(changes) == 2


@pytest.mark.parametrize("changes", [{"armed": False}, {"vehicles": abreast(*AROUND, speed_mps=0.0), "winged": False}])
def test_on_the_ground_nothing_is_lost(changes: dict) -> None:
    fleet = ReadyFleet(**{"vehicles": abreast(*AROUND), **changes})
    assert told(fleet, 16.0).state is ReadinessState.READY
    fleet.ranged = []
    readiness = told(fleet, 45.0)
    assert readiness.state is ReadinessState.NOT_READY
    assert not readiness.is_lost


def test_one_vehicle_at_a_time_and_each_three_times_in_half_a_minute() -> None:
    fleet = ReadyFleet(abreast(*AROUND))
    fleet.fly(40.0)
    at_s = [v.readiness.at_s for v in fleet.engine.snapshot(40.0).vehicles if v.readiness is not None]
    assert len(at_s) == len(set(at_s)) == 5
    own = [readiness.at_s for readiness in fleet.seen]
    assert own == pytest.approx([own[0] + 10.0 * k for k in range(len(own))])


def test_a_prediction_changes_nothing_in_the_filter() -> None:
    """All that the engine states and sends is the same with the prediction as without it."""

    class Silent(type(ReadyFleet(abreast()).estimator)):
        predict_loss = None

    flown = []
    for fleet in (ReadyFleet(abreast(*AROUND)), ReadyFleet(abreast(*AROUND), estimator=Silent())):
        fleet.fly(15.0)
        fleet.fix_types[RANGED] = 1
        fleet.fly(40.0)
        answer = fleet.engine.estimate(RANGED, 40.0)
        flown.append((answer.position_enu_m.tolist(), answer.covariance.tolist(), answer.protection, fleet.outputs))
    assert flown[0] == flown[1]


def test_every_reason_stands_in_the_explanation():
    text = (Path(__file__).resolve().parents[4] / "docs/explanation/readiness.md").read_text(encoding="utf-8")
    assert [reason.code for reason in LimitingReason if f"`{reason.code}`" not in text] == []
