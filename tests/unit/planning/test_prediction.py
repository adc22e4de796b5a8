"""The prediction is the fleet filter's own along the planned ways: geometry, singular instants, what limits a fix."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import VehicleClass
from gcs_coloc.planning import prediction
from gcs_coloc.planning.fleet_plan import FleetPlan, PlanAssumptions, PlannedStation, PlannedVehicle
from gcs_coloc.planning.flight_path import Leg
from gcs_coloc.planning.load import load_plan
from gcs_coloc.planning.prediction import predict

PAPER = Path(__file__).resolve().parents[3] / "sitl_fakes/scenarios/paper.toml"
FRAME = LocalFrame(47.0, 8.0, 500.0)


def straight(sysid, begin, end, speed=20.0, kind=VehicleClass.PLANE, up=100.0):
    return PlannedVehicle(sysid, f"v{sysid}", (*begin, up), (Leg((*end, up), speed),), 0.0, kind)


def directions(positions, sysid):
    d = np.array([positions[sysid] - place for other, place in positions.items() if other != sysid])[:, :2]
    return d / np.linalg.norm(d, axis=1)[:, np.newaxis]


def papers_hdop(positions):
    """Qu & Zhang, eq. (23) to (26): A = H1^-1 H1^-T with the column of a clock bias."""
    inverse = np.linalg.inv(np.column_stack([directions(positions, 4), np.ones(3)]))
    return math.sqrt(np.trace((inverse @ inverse.T)[:2, :2]))


def line_of_peers(positions):
    """Zero where the three peers stand in one line: there H of eq. (16) is singular."""
    (ae, an), (be, bn), (ce, cn) = (positions[k][:2] for k in (1, 2, 3))
    return (be - ae) * (cn - an) - (bn - an) * (ce - ae)


def changes_of_sign(at_s, values):
    return [at for at, (a, b) in zip(at_s[1:], pairwise(values), strict=True) if a * b <= 0.0]


def along_first_leg(at_s):
    """Table 1: all fly their first legs until 80 s."""
    legs = {
        1: ((0, 0), (0, 4000)),
        2: ((8000, 0), (4000, 8000)),
        3: ((7000, 8000), (3000, 9000)),
        4: ((2000, -4000), (6000, -4000)),
    }
    places = {}
    for sysid, (begin, end) in legs.items():
        way = np.subtract(end, begin)
        places[sysid] = np.array((*(begin + 50.0 * at_s * way / np.linalg.norm(way)), 0.0))
    return places


def test_the_papers_flight_gives_the_papers_hdop_curve_with_its_two_singular_instants():
    plan = load_plan([PAPER])
    (predicted,) = predict(plan, (4,))
    places = [plan.positions(at_s) for at_s in predicted.at_s]
    curve = np.array([papers_hdop({**place, 4: here}) for place, here in zip(places, predicted.position_enu_m, strict=True)])
    straight_on = predicted.at_s < 75.0
    literal = [papers_hdop(along_first_leg(at_s)) for at_s in predicted.at_s[straight_on]]
    assert curve[straight_on] == pytest.approx(literal, rel=0.02)
    # The fix from three ranges is singular where the peers stand in one line, its error equation where two are seen in one place.
    assert changes_of_sign(predicted.at_s, [line_of_peers(place) for place in places]) == pytest.approx([160.0, 240.0], abs=5.0)
    assert predicted.at_s[curve > 1000.0][0] == pytest.approx(130.0, abs=5.0)
    # The ranges themselves have no clock: their dilution stays finite, and the filter passes both places.
    assert predicted.hdop.max() < 20.0
    horizontal = [directions(place, 4)[:, :2] for place in places]
    expected = [math.sqrt(np.trace(np.linalg.inv(G.T @ G))) for G in horizontal]
    assert predicted.hdop == pytest.approx(expected, rel=1e-3)
    assert predicted.has_fix.all()


def square(sysid, east, north, size=400.0, speed_mps=20.0, **more):
    corners = [(east, north), (east + size, north), (east + size, north + size), (east, north + size)]
    legs = tuple(Leg((*corner, 100.0), speed_mps) for corner in (*corners[1:], *corners))
    return PlannedVehicle(sysid, f"v{sysid}", (*corners[0], 100.0), legs, **more)


def test_three_peers_well_around_it_give_a_fix_for_the_whole_flight():
    plan = FleetPlan(FRAME, (square(1, 0, 0), square(2, 900, 0), square(3, 0, 900), square(4, 900, 900)))
    (predicted,) = predict(plan, (1,))
    assert predicted.share_with_fix == 1.0
    assert 0.5 < np.median(predicted.bound_95_m) < 6.0
    assert (predicted.hpl_m > predicted.bound_95_m).all()
    assert np.max(predicted.offset_m) < 3.0


def test_what_limits_a_fix_is_named():
    lonely = FleetPlan(FRAME, (straight(1, (0, 0), (600, 0), kind=VehicleClass.MULTIROTOR), square(2, 9e4, 0)))
    (predicted,) = predict(lonely, (1,))
    assert predicted.limit_code[-1] == "no_peer"
    assert predicted.share_with_fix < 0.6
    pair = FleetPlan(FRAME, (straight(1, (0, 0), (600, 0), kind=VehicleClass.MULTIROTOR), straight(2, (0, 50), (600, 50))))
    (predicted,) = predict(pair, (1,))
    assert predicted.limit[-1] == "one peer ranged: 2"
    column = [straight(k, (200.0 * k, 0), (200.0 * k + 600, 0), kind=VehicleClass.MULTIROTOR) for k in (1, 2, 3)]
    (predicted,) = predict(FleetPlan(FRAME, tuple(column)), (1,))
    assert predicted.limit_code[-1] == "in_line"
    assert predicted.limit[-1].startswith("peers 2 and 3 in one line with it")


def test_a_station_helps_where_peers_do_not():
    column = tuple(straight(k, (200.0 * k, 0), (200.0 * k + 1500, 0), kind=VehicleClass.MULTIROTOR) for k in (1, 2, 3))
    without = predict(FleetPlan(FRAME, column), (1,))[0].share_with_fix
    stations = (PlannedStation(7, (800.0, 900.0, 10.0)),)
    assert predict(FleetPlan(FRAME, column, stations), (1,))[0].share_with_fix > without + 0.3


def test_more_noise_and_a_second_denied_vehicle_make_it_worse():
    vehicles = (square(1, 0, 0), square(2, 700, 0), square(3, 0, 700), square(4, 700, 700))
    plan = FleetPlan(FRAME, vehicles)
    alone = predict(plan, (1,))[0]
    with_another = predict(plan, (1, 2))[0]
    noisy = predict(replace(plan, assumptions=PlanAssumptions(range_sigma_m=3.0)), (1,))[0]
    assert np.median(alone.bound_95_m) < np.median(with_another.bound_95_m)
    assert np.median(alone.bound_95_m) < np.median(noisy.bound_95_m)
    assert with_another.denied == (1, 2)


@pytest.mark.parametrize(
    ("kind", "peers_north_m", "stations", "has_fix"),
    [("multirotor", 700.0, 0, True), ("multirotor", 200.0, 0, False), ("multirotor", 200.0, 1, True), ("plane", 200.0, 0, True)],
)
def test_two_denied_copters_that_cross_the_line_of_two_peers_are_on_either_side_of_it(kind, peers_north_m, stations, has_fix):
    """Those of 700 m never come to that line."""
    vehicles = tuple(square(k, east, 0, speed_mps=10.0, vehicle_class=VehicleClass(kind)) for k, east in ((1, 0), (2, 700)))
    for k, east in ((3, 0.0), (4, 700.0)):
        slow = (Leg((east + 300.0, peers_north_m, 100.0), 1.0),)
        vehicles += (PlannedVehicle(k, f"v{k}", (east, peers_north_m, 100.0), slow, vehicle_class=VehicleClass(kind)),)
    beside = (PlannedStation(1, (1500.0, 350.0, 10.0)),)[:stations]
    for predicted in predict(FleetPlan(FRAME, vehicles, beside), (1, 2)):
        assert (predicted.share_with_fix > 0.9) is has_fix


def test_a_vehicle_takes_part_between_start_and_end_alone():
    late = square(2, 700, 0, start_s=60.0, end_s=120.0)
    plan = FleetPlan(FRAME, (square(1, 0, 0), late, square(3, 0, 700)))
    (predicted,) = predict(plan, (1,))
    ranged = dict(zip(predicted.at_s.tolist(), predicted.ranged.tolist(), strict=True))
    assert [ranged[min(ranged, key=lambda t, at=at: abs(t - at))] for at in (30.0, 90.0, 130.0)] == [1.0, 2.0, 1.0]


def test_the_flight_keeps_to_its_legs_and_turns_no_tighter_than_its_class():
    path = square(1, 0, 0).path()
    speeds = np.linalg.norm(path.velocities_mps[:-1, :2], axis=1)
    assert speeds == pytest.approx(20.0)
    turns = [math.remainder(math.atan2(*b[:2]) - math.atan2(*a[:2]), 2 * math.pi) for a, b in pairwise(path.velocities_mps[:-1])]
    assert max(map(abs, turns)) / 0.5 * 20.0 <= 9.81 * math.tan(math.radians(30.0)) * 1.01
    corner = np.array((400.0, 400.0))
    assert 0.0 < np.linalg.norm(path.positions_m[:, :2] - corner, axis=1).min() < 80.0
    assert path.positions_m[:, 0].min() > -40.0


def test_a_vehicle_that_holds_circles_its_waypoint():
    leg = Leg((500.0, 0.0, 100.0), 20.0, hold_s=120.0, radius_m=90.0)
    path = PlannedVehicle(1, "v", (0.0, 0.0, 100.0), (leg,)).path()
    late = path.positions_m[-120:, :2] - (500.0, 0.0)
    assert np.linalg.norm(late, axis=1) == pytest.approx(np.full(120, 90.0), abs=15.0)


def ratios_to_the_rates_of_the_service(plan, sysid):
    """Return the bound over the root mean square of those in the same step at the rates of the service, and the prediction."""
    condensed, at_rates = predict(plan, (sysid,))[0], predict(plan, (sysid,), 0.2)[0]
    last_s = condensed.at_s - np.diff(condensed.at_s, prepend=0.0)
    within = [(at_rates.at_s > a + 1e-6) & (at_rates.at_s <= b + 1e-6) for a, b in zip(last_s, condensed.at_s, strict=True)]
    settled = condensed.at_s > 25.0
    expected = [np.sqrt(np.mean(at_rates.bound_95_m[step] ** 2)) for step in np.array(within)[settled]]
    return condensed.bound_95_m[settled] / expected, condensed


def test_condensed_steps_come_to_what_the_filter_states_at_the_rates_of_the_service():
    vehicles = tuple(square(k, 900.0 * (k % 3), 900.0 * (k // 3), 500.0, end_s=90.0) for k in range(1, 11))
    ratios, condensed = ratios_to_the_rates_of_the_service(FleetPlan(FRAME, vehicles), 5)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.03)
    assert ratios == pytest.approx(np.ones(len(ratios)), abs=0.15)
    # Of nine peers in range the filter uses eight; HDOP and number are of all.
    assert set(condensed.ranged.tolist()) == {9.0}


def test_condensed_steps_come_to_it_without_air_data_and_with_stations_alone():
    kind = VehicleClass.MULTIROTOR
    squares = [square(k, 300.0 * (k % 2), 300.0 * (k // 2), 200.0, end_s=60.0) for k in (1, 2, 3)]
    copters = tuple(replace(each, vehicle_class=kind) for each in squares)
    ratios, _ = ratios_to_the_rates_of_the_service(FleetPlan(FRAME, copters), 1)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.03)
    stations = tuple(PlannedStation(k, (700.0 * (k % 2), 700.0 * (k // 2), 15.0), 0.1) for k in range(4))
    ratios, _ = ratios_to_the_rates_of_the_service(FleetPlan(FRAME, (square(1, 100, 100, end_s=60.0),), stations), 1)
    assert ratios == pytest.approx(np.ones(len(ratios)), abs=0.15)


def test_slow_ranges_count_no_more_than_they_tell():
    kind = VehicleClass.MULTIROTOR
    squares = [square(k, 300.0 * (k % 2), 300.0 * (k // 2), 200.0, end_s=60.0) for k in (1, 2, 3, 4)]
    copters = FleetPlan(FRAME, tuple(replace(each, vehicle_class=kind) for each in squares))
    usual, slow = (replace(copters, assumptions=PlanAssumptions(range_rate_hz=hz)) for hz in (0.5, 0.25))
    ratios = predict(slow, (1,), 0.5)[0].bound_95_m / predict(usual, (1,), 0.5)[0].bound_95_m
    assert np.median(ratios[50:]) > 1.02


def test_the_noise_counts_as_known_on_both_sides_of_a_line_of_peers(monkeypatch: pytest.MonkeyPatch):
    """In the hypotheses it was learned: after a minute without any noise their manoeuvres counted for a thirtieth."""
    ratios = []

    class Watched(prediction.FleetHypotheses):
        def apply(self, m):
            result = super().apply(m)
            main = self.main.records
            for each in self.hypotheses.values():
                for sysid, record in each.model.records.items():
                    ratios.append(record.manoeuvre_noise.level / main[sysid].manoeuvre_noise.level)
            return result

    monkeypatch.setattr(prediction, "FleetHypotheses", Watched)
    kind = VehicleClass.MULTIROTOR
    legs = tuple(Leg((100.0 + 120.0 * k, 60.0 - 40.0 * (k % 2), 100.0), 8.0) for k in range(8))
    beside = PlannedVehicle(1, "v1", (0.0, 60.0, 100.0), legs, 0.0, kind)
    peers = (straight(2, (-200, 0), (800, 0), 8.0, kind), straight(3, (400, 0), (1400, 0), 8.0, kind))
    predict(FleetPlan(FRAME, (beside, *peers)), (1,))
    assert len(ratios) > 1000
    assert min(ratios) > 0.9
