"""Unisolated ranges: they end by a test, or long after; a pair that was isolated is known for a while."""

import pytest

from gcs_coloc.core.integrity.epoch_tests.noise_model import NoiseModel
from gcs_coloc.core.integrity.unisolated_ranges import UnisolatedRanges

OPEN = NoiseModel(pairs_off=frozenset({(1, 4)}), unisolated=frozenset({(1, 4), (3, 4)}))
ISOLATED = NoiseModel(pairs_off=frozenset({(1, 4)}))


@pytest.fixture
def unisolated():
    made = UnisolatedRanges()
    made.add(OPEN, 10.0)
    return made


def test_they_end_two_seconds_after_tests_begin_to_find_nothing(unisolated):
    unisolated.clear({(1, 4), (3, 4)}, 10.0)  # seen in this very review
    unisolated.clear({(1, 4)}, 11.0)
    unisolated.clear({(1, 4)}, 12.9)
    assert set(unisolated.ranges) == {(1, 4), (3, 4)}
    unisolated.clear({(1, 4)}, 13.0)
    assert set(unisolated.ranges) == {(3, 4)}


def test_without_a_test_they_last_for_ten_minutes(unisolated):
    unisolated.clear({(1, 4), (3, 4)}, 11.0)
    unisolated.clear((), 12.0)  # begins anew
    unisolated.clear({(1, 4), (3, 4)}, 13.0)
    unisolated.clear((), 609.0)
    assert set(unisolated.ranges) == {(1, 4), (3, 4)}
    unisolated.clear((), 610.0)
    assert not unisolated.ranges


def test_only_an_isolated_pair_is_known_and_for_ten_seconds(unisolated):
    assert not unisolated.known(10.0)
    unisolated.add(ISOLATED, 11.0)
    assert unisolated.known(20.9) == {(1, 4)}
    assert not unisolated.known(21.0)


def test_a_forgotten_vehicle_takes_its_ranges_with_it(unisolated):
    unisolated.add(ISOLATED, 11.0)
    unisolated.forget(1)
    assert set(unisolated.ranges) == {(3, 4)}
    assert not unisolated.known(11.0)
