"""Positions that are kilometres from where the ranges put them: who is named, and who is not."""

from __future__ import annotations

from collections.abc import Iterable
from math import dist

import pytest

from gcs_coloc.core.integrity.epoch_tests.epoch import Epoch, PositionPrior, RangeResidual
from gcs_coloc.core.integrity.epoch_tests.gross_faults import gross_faults, without_ranges_of

TRUE = {
    1: (0.0, 0.0, 100.0),
    2: (1200.0, 100.0, 120.0),
    3: (300.0, 1400.0, 90.0),
    4: (-900.0, 700.0, 140.0),
    5: (200.0, 600.0, 110.0),
}
AIRPORT = (90_000.0, -40_000.0, -700.0)
"""A spoofer's place: below the fleet's plane, as the earth is there."""
STAR = [(5, peer) for peer in (1, 2, 3, 4)]
MUTUAL = [(i, j) for i in TRUE for j in TRUE if i < j]


def epoch(pairs: Iterable[tuple[int, int]], said: dict[int, tuple[float, float, float]], free: tuple[int, ...] = (5,)) -> Epoch:
    """An epoch of exact ranges; `said` are positions other than the true ones."""
    places = TRUE | said
    priors = {vehicle: PositionPrior(place, 1.5, 2.0, vehicle in free) for vehicle, place in places.items()}
    residuals = (RangeResidual(i, j, dist(TRUE[i], TRUE[j]) - dist(places[i], places[j]), 1.0) for i, j in pairs)
    return Epoch(0.0, priors, tuple(residuals))


@pytest.mark.parametrize("pairs", [STAR, MUTUAL])
def test_one_that_states_an_airport_is_named_with_how_far_off_it_is(pairs):
    found = gross_faults(epoch(pairs, {1: AIRPORT}))
    assert found == {1: pytest.approx(97_500.0, abs=1500.0)}


def test_two_that_state_the_same_airport_are_named_by_three():
    assert gross_faults(epoch(MUTUAL, {1: AIRPORT, 2: AIRPORT}, free=())).keys() == {1, 2}


def test_where_half_of_those_that_report_are_elsewhere_nobody_is_named():
    assert gross_faults(epoch(MUTUAL, {1: AIRPORT, 2: AIRPORT})) == {}


def test_one_that_alone_has_ranges_is_named_by_its_peers_that_agree_on_the_region():
    assert gross_faults(epoch(STAR, {5: AIRPORT}, free=())).keys() == {5}


def test_an_estimate_that_is_elsewhere_names_nobody():
    assert gross_faults(epoch(STAR, {5: AIRPORT})) == {}


def test_one_that_is_truly_far_away_is_not_named():
    far = (60_000.0, 0.0, -280.0)
    priors = {vehicle: PositionPrior(place, 1.5, 2.0, vehicle == 5) for vehicle, place in (TRUE | {4: far, 1: AIRPORT}).items()}
    near = [RangeResidual(5, peer, 0.0, 1.0) for peer in (2, 3, 4)]
    spoofed = RangeResidual(5, 1, dist(TRUE[5], TRUE[1]) - dist(TRUE[5], AIRPORT), 1.0)
    assert gross_faults(Epoch(0.0, priors, (*near, spoofed))).keys() == {1}


def test_a_range_that_is_far_too_long_names_nobody():
    sound = epoch(MUTUAL, {})
    residuals = [residual._replace(residual_m=65_000.0) if 1 in residual.pair else residual for residual in sound.residuals]
    assert gross_faults(sound.with_noise(sound.priors, tuple(residuals))) == {}


def test_the_rest_of_the_epoch_has_no_range_of_it():
    whole = epoch(MUTUAL, {1: AIRPORT})
    rest = without_ranges_of(whole, gross_faults(whole))
    assert {residual.pair for residual in rest.residuals} == {pair for pair in MUTUAL if 1 not in pair}


def test_an_epoch_without_gross_faults_is_the_same_object():
    sound = epoch(MUTUAL, {1: (500.0, 0.0, 100.0)})
    assert without_ranges_of(sound, gross_faults(sound)) is sound
