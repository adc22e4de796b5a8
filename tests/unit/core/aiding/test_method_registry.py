"""The registry of aiding methods: what the settings may name is what there is."""

from typing import get_args

import pytest

from gcs_coloc.core.aiding.methods.registry import METHODS, method_for, mismatch
from gcs_coloc.core.aiding.settings import AidingMethodName, AidingSettings
from gcs_coloc.core.messages.inbound import Autopilot


def test_every_name_of_the_settings_is_a_method_and_the_other_way_round():
    assert set(METHODS) == set(get_args(AidingMethodName))


@pytest.mark.parametrize("autopilot", [Autopilot.ARDUPILOT, Autopilot.PX4])
def test_the_default_is_a_method_that_the_autopilot_accepts(autopilot):
    assert mismatch(method_for(4, autopilot, AidingSettings(), lambda _: "vision_position"), autopilot) is None
