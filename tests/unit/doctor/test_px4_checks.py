"""The checks of PX4: which way its parameters let our positions and ranges in, and the parameter to set."""

from __future__ import annotations

from dataclasses import replace

import pytest
from vehicle_surveys import FLEET, GOOD, PX4_SLOT, WANTED_HZ, said

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.doctor.finding import Setup, Severity
from gcs_coloc.doctor.report import of_vehicle

VISION = {"EKF2_EV_CTRL": 1.0, "EKF2_EV_NOISE_MD": 0.0, "EKF2_EV_DELAY": 0.0}


@pytest.mark.parametrize(
    ("parameters", "stopped", "words"),
    [
        (PX4_SLOT, [], "reboot it"),
        (PX4_SLOT | {"EKF2_AGP0_CTRL": 3.0, "EKF2_AGP1_ID": 0.0, "EKF2_AGP1_CTRL": 1.0}, [], "reboot it"),
        (PX4_SLOT | VISION, [], "reboot it"),
        (PX4_SLOT | {"EKF2_AGP0_CTRL": 2.0}, [("EKF2_AGP0_CTRL", 3.0)], "does not take GLOBAL_POSITION_SENSOR"),
        (PX4_SLOT | {"EKF2_AGP0_ID": 0.0}, [("EKF2_AGP0_ID", 1.0)], "the slot is off"),
        (PX4_SLOT | {"EKF2_AGP0_ID": 7.0}, [("EKF2_AGP0_ID", 1.0)], "waits for another sensor id"),
        (PX4_SLOT | {"EKF2_AGP0_DELAY": 300.0}, [("EKF2_AGP0_DELAY", 0.0)], "0.3 s old"),
        (PX4_SLOT | {"EKF2_SENS_EN": 8191.0}, [], "reboot it"),
        (PX4_SLOT | {"EKF2_SENS_EN": 8190.0}, [("EKF2_SENS_EN", 8191.0)], "does not use its own GPS"),
        (PX4_SLOT | {"EKF2_SENS_EN": 8175.0}, [("EKF2_SENS_EN", 8191.0)], "auxiliary global position that we send"),
        (PX4_SLOT | {"EKF2_AGP2_ID": 5.0, "EKF2_AGP2_CTRL": 1.0}, [], "positions of sensor 5 as well"),
        (
            {"EKF2_AGP0_CTRL": 1.0, "EKF2_AGP0_ID": 9.0, "EKF2_AGP1_ID": 1.0, "EKF2_AGP1_CTRL": 0.0},
            [("EKF2_AGP1_CTRL", 1.0)],
            "positions of sensor 9 as well",
        ),
        (PX4_SLOT | {"EKF2_AGP0_CTRL": 0.0, "EKF2_AGP1_ID": 1.0, "EKF2_AGP1_CTRL": 1.0}, [], "EKF2_AGP1_ID = 1 counts"),
        (
            PX4_SLOT | {"EKF2_AGP0_CTRL": 0.0, "EKF2_AGP1_ID": 1.0, "EKF2_AGP1_CTRL": 1.0, "EKF2_AGP1_DELAY": 300.0},
            [("EKF2_AGP1_DELAY", 0.0)],
            "0.3 s old",
        ),
        (
            PX4_SLOT | {"EKF2_AGP0_CTRL": 0.0, "EKF2_AGP1_ID": 1.0, "EKF2_AGP1_CTRL": 0.0},
            [("EKF2_AGP0_CTRL", 1.0)],
            "does not take GLOBAL_POSITION_SENSOR",
        ),
        ({"EKF2_AGP0_CTRL": 1.0}, [None], "EKF2_AGP0_ID could not be read"),
        (VISION | {"EKF2_AGP_CTRL": 1.0}, [], "receive no GLOBAL_POSITION_SENSOR"),
        ({"EKF2_AGP_CTRL": 1.0, "EKF2_EV_CTRL": 0.0}, [("EKF2_EV_CTRL", 1.0)], "does not take VISION_POSITION_ESTIMATE"),
        (VISION | {"EKF2_EV_CTRL": 8.0}, [("EKF2_EV_CTRL", 9.0)], "does not take VISION_POSITION_ESTIMATE"),
        (VISION | {"EKF2_EV_CTRL": 3.0}, [], "height that we compute"),
        (VISION | {"EKF2_EV_NOISE_MD": 1.0}, [("EKF2_EV_NOISE_MD", 0.0)], "EKF2_EVP_NOISE"),
        (VISION | {"EKF2_SENS_EN": 8183.0}, [("EKF2_SENS_EN", 8191.0)], "does not use VISION_POSITION_ESTIMATE"),
        (VISION | {"EKF2_EV_DELAY": 175.0}, [("EKF2_EV_DELAY", 0.0)], "0.175 s old"),
    ],
)
def test_px4_must_take_the_method_that_it_is_sent(parameters, stopped, words):
    findings = said(replace(GOOD, autopilot=Autopilot.PX4, parameters=parameters))
    assert [finding.parameter for finding in findings if finding.severity is Severity.STOP] == stopped
    assert words in " ".join(finding.text + (finding.remedy or "") for finding in findings)


RANGES = {"EKF2_RNGBC_CTRL": 1.0, "EKF2_RNGBC_NOISE": 0.5, "EKF2_RNGBC_DELAY": 0.0}


@pytest.mark.parametrize(
    ("parameters", "stopped", "words"),
    [
        (RANGES, [], "takes RANGING_BEACON"),
        (RANGES | PX4_SLOT | {"EKF2_AGP0_CTRL": 0.0}, [], "takes RANGING_BEACON"),
        (RANGES | {"EKF2_RNGBC_CTRL": 0.0}, [("EKF2_RNGBC_CTRL", 1.0)], "does not take RANGING_BEACON"),
        (RANGES | {"EKF2_RNGBC_NOISE": 30.0}, [("EKF2_RNGBC_NOISE", 1.0)], "no range for better than 30 m"),
        (RANGES | {"EKF2_RNGBC_DELAY": 100.0}, [("EKF2_RNGBC_DELAY", 0.0)], "0.1 s old"),
        (RANGES | {"EKF2_SENS_EN": 4095.0}, [("EKF2_SENS_EN", 8191.0)], "does not use RANGING_BEACON"),
        (PX4_SLOT, [None], "its firmware fuses no ranges"),
    ],
)
def test_px4_must_fuse_the_ranges_that_it_is_handed(parameters, stopped, words):
    vehicle = replace(GOOD, autopilot=Autopilot.PX4, parameters=parameters)
    findings = said(vehicle, Setup(aiding=AidingSettings(method="ranging_beacon")))
    assert [finding.parameter for finding in findings if finding.severity is Severity.STOP] == stopped
    told = of_vehicle(vehicle, Setup(aiding=AidingSettings(method="ranging_beacon")), FLEET)
    assert words in " ".join(finding.text + (finding.remedy or "") for finding in told)


def test_a_slot_of_px4_is_read_at_its_start_alone():
    (finding,) = said(replace(GOOD, autopilot=Autopilot.PX4, parameters=PX4_SLOT | {"EKF2_AGP0_ID": 0.0}))
    assert "then reboot it" in finding.remedy


def test_px4_is_not_asked_for_what_only_ardupilot_sends():
    rates = {k: v for k, v in WANTED_HZ.items() if k not in (124, 193)}
    texts = [finding.text for finding in said(replace(GOOD, autopilot=Autopilot.PX4, parameters={}, rates_hz=rates))]
    assert not any("GPS2_RAW" in text or "EKF_STATUS" in text for text in texts)
