"""EKF3's gates as measured: 7.5 m, 11.25 m, 1.5 m/s, HDOP 2.5 and 6 satellites by its default parameters."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gcs_coloc.core.aiding.fix_policy import EkfGates
from gcs_coloc.core.aiding.methods.gps_input import no_fix

GOOD = replace(
    no_fix(4, 1), fix_type=3, horiz_accuracy_m=7.5, vert_accuracy_m=11.25, speed_accuracy_mps=1.5, hdop=2.5, satellites=6
)
DEFAULT = EkfGates(31, 150.0)


def test_what_is_just_within_every_gate_is_taken():
    assert DEFAULT.refusal(GOOD) is None


@pytest.mark.parametrize(
    ("beyond", "bit", "words"),
    [
        ({"horiz_accuracy_m": 7.6}, 8, "horizontal accuracy 7.6 m, it takes 7.5 m"),
        ({"vert_accuracy_m": 11.3}, 8, "vertical accuracy 11.3 m, it takes 11.25 m"),
        ({"speed_accuracy_mps": 1.6}, 4, "speed accuracy 1.6 m/s, it takes 1.5 m/s"),
        ({"hdop": 2.6}, 2, "HDOP 2.6, it takes 2.5"),
        ({"satellites": 5}, 1, "5 satellites, it wants 6"),
    ],
)
def test_each_gate_refuses_in_words_unless_its_check_is_off(beyond, bit, words):
    fix = replace(GOOD, **beyond)
    assert DEFAULT.refusal(fix) == words
    assert EkfGates(31 - bit, 150.0).refusal(fix) is None


def test_the_scale_widens_accuracies_only():
    fix = replace(GOOD, horiz_accuracy_m=9.9, vert_accuracy_m=14.9, speed_accuracy_mps=1.9)
    assert EkfGates(31, 200.0).refusal(fix) is None
    assert EkfGates(31, 200.0).refusal(replace(fix, hdop=2.6)) == "HDOP 2.6, it takes 2.5"
