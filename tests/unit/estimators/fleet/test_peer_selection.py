from __future__ import annotations

import numpy as np
import pytest

from gcs_coloc.core.error_ellipse import horizontal_dilution_of
from gcs_coloc.core.measurements import AltitudeMeasurement, FloatArray, PositionMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome
from gcs_coloc.estimators.fleet.fleet_model import FleetModel
from gcs_coloc.estimators.fleet.peer_selection import select_peers
from gcs_coloc.estimators.fleet.settings import FleetSettings

NONE: frozenset[int] = frozenset()
HERE = np.array([0.0, 0.0, 100.0])


def fleet(seed: int) -> list[tuple[int, FloatArray]]:
    rng = np.random.default_rng(seed)
    return [(v, np.array([*rng.uniform(-2500.0, 2500.0, 2), rng.uniform(50.0, 150.0)])) for v in range(60)]


def hdop(chosen: frozenset[int], placed: list[tuple[int, FloatArray]], here: FloatArray = HERE) -> float:
    offsets = np.array([here - position for vehicle, position in placed if vehicle in chosen])
    return horizontal_dilution_of((offsets / np.linalg.norm(offsets, axis=1)[:, np.newaxis]).tolist())


@pytest.mark.parametrize("seed", range(10))
def test_eight_of_sixty_are_nearly_as_good_as_the_best_eight_in_a_round(seed):
    placed = fleet(seed)
    # Eight directions at equal angles have sqrt(4 / 8) of two ranges at a right angle: HDOP 0.707, nothing is better.
    assert hdop(select_peers(HERE, placed, NONE, NONE, 8, height_known=True), placed) < 0.75


@pytest.mark.parametrize("seed", range(10))
def test_two_denied_vehicles_share_most_of_their_peers_and_lose_little_by_it(seed):
    placed = fleet(seed)
    there = np.array([800.0, -600.0, 120.0])
    first = select_peers(HERE, placed, NONE, NONE, 8, height_known=True)
    second = select_peers(there, placed, NONE, first, 8, height_known=True)
    alone = select_peers(there, placed, NONE, NONE, 8, height_known=True)
    assert len(first & second) >= 5
    assert hdop(second, placed, there) < 1.1 * hdop(alone, placed, there)


def test_a_denied_vehicle_that_tells_its_height_spends_its_choice_on_the_horizontal():
    placed = [(v, np.array([2000.0 * np.sin(v), 2000.0 * np.cos(v), 100.0])) for v in range(12)]
    placed.extend((90 + v, np.array([100.0 + 40.0 * v, 90.0, 400.0])) for v in range(3))
    without, with_height = (select_peers(HERE, placed, NONE, NONE, 3, height_known=known) for known in (False, True))
    assert without & {90, 91, 92}
    assert hdop(with_height, placed) < 0.9 * hdop(without, placed)


@pytest.mark.parametrize("ends", [(1, 2), (2, 1)])
def test_a_range_that_one_end_does_not_select_is_known_to_both_whichever_of_them_measured_it(ends):
    """The end that came second never learned of it where the first one had better peers."""
    model = FleetModel(FleetSettings(peers_per_denied_vehicle=3))
    places = dict(fleet(1)) | {1: HERE, 2: np.array([0.0, 0.0, 400.0])}
    for vehicle, place in places.items():
        model.apply(PositionMeasurement(vehicle, 0.0, 0.0, tuple(place.tolist()), 0.5, 0.5, (0.0, 0.0, 0.0), 0.3))
    model.set_denied(frozenset({1, 2}), 0.1)
    for peer in range(3, 30):
        model.apply(RangeMeasurement(1, peer, 0.2, 0.2, float(np.linalg.norm(places[peer] - HERE)), 1.0))
    for t in (2.4, 2.6):
        model.apply(AltitudeMeasurement(1, t, t, 100.0, 0.5))
        assert model.apply(RangeMeasurement(*ends, t, t, 300.0, 0.5)).outcome is Outcome.KEPT_NOT_SELECTED
    first, second = model.records[1], model.records[2]
    assert 2 not in first.selected_peers
    assert first.last_range_s[2] == second.last_range_s[1] == 2.6
    assert second.selected_peers == {1}
    assert len(second.range_measurements) == 2
    assert second.presumed_bias is not None
