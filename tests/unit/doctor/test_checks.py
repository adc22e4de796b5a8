"""Each check by a table: what was found, what is said of it, and the parameter to set."""

from __future__ import annotations

from dataclasses import replace

import pytest
from vehicle_surveys import FLEET, GOOD, PARAMETERS, PX4_SLOT, RECEIVER, WANTED_HZ, said, with_parameters

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.messages.control import RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.doctor.finding import Setup, Severity
from gcs_coloc.doctor.report import CLOCKS_AGREE_S, is_ready, of_vehicle

BEFORE_4_6 = {
    "GPS1_TYPE": "GPS_TYPE",
    "GPS2_TYPE": "GPS_TYPE2",
    "GPS1_DELAY_MS": "GPS_DELAY_MS",
    "GPS2_DELAY_MS": "GPS_DELAY_MS2",
}
BEFORE_4_7 = {"MAV_OPTIONS": "SYSID_ENFORCE", "MAV_GCS_SYSID": "SYSID_MYGCS"}


def renamed(names):
    return {names.get(name, name): value for name, value in PARAMETERS.items()}


@pytest.mark.parametrize("names", [{}, BEFORE_4_6, BEFORE_4_6 | BEFORE_4_7])
def test_of_a_vehicle_that_is_set_up_right_nothing_is_said_but_that(names):
    findings = of_vehicle(replace(GOOD, parameters=renamed(names)), Setup(), FLEET)
    assert {finding.severity for finding in findings} == {Severity.RIGHT}
    text = " ".join(finding.text for finding in findings)
    assert f"{names.get('GPS2_TYPE', 'GPS2_TYPE')} = 14" in text
    assert "it aligns on GPS positions up to 1-sigma of 7.5 m horizontally, 11.25 m vertically and 1.5 m/s; once aligned" in text


@pytest.mark.parametrize(
    ("checks", "method", "said"),
    [
        (31.0, "auto", "1.5 m/s; once aligned it fuses any accuracy, and until then coarser ones go by MAV_CMD_EXTERNAL"),
        (31.0, "gps_input", "1.5 m/s; once aligned it fuses any accuracy"),
        (19.0, "auto", "it aligns on GPS positions however coarse they say they are"),
    ],
)
def test_the_limits_of_ekf3_are_told_as_those_of_its_alignment_alone(checks, method, said):
    vehicle = with_parameters(EK3_GPS_CHECK=checks)
    findings = of_vehicle(vehicle, Setup(aiding=AidingSettings(method=method)), FLEET)
    [text] = [finding.text for finding in findings if "EK3_GPS_CHECK" in finding.text]
    assert said in text
    assert ("EXTERNAL" in text) == ("EXTERNAL" in said)


@pytest.mark.parametrize(
    ("changes", "words", "parameter"),
    [
        ({"GPS2_TYPE": 0.0}, "does not take GPS_INPUT", ("GPS2_TYPE", 14.0)),
        ({"GPS1_TYPE": 14.0}, "own receiver is switched off", ("GPS1_TYPE", 1.0)),
        ({"GPS_AUTO_SWITCH": 0.0}, "for ever", ("GPS_AUTO_SWITCH", 4.0)),
        ({"GPS_AUTO_SWITCH": 1.0}, "leave a healthy receiver", ("GPS_AUTO_SWITCH", 4.0)),
        ({"GPS_AUTO_SWITCH": 2.0}, "blends", ("GPS_AUTO_SWITCH", 4.0)),
        ({"GPS_AUTO_SWITCH": 3.0}, "not what was tested", ("GPS_AUTO_SWITCH", 4.0)),
        ({"GPS_PRIMARY": 1.0}, "comes first", ("GPS_PRIMARY", 0.0)),
        ({"EK3_SRC1_POSXY": 6.0}, "does not come from GPS", ("EK3_SRC1_POSXY", 3.0)),
        ({"MAV_OPTIONS": 1.0}, "listens to MAV_GCS_SYSID = 255 only, and we are 254", None),
        ({"GPS2_TYPE": None}, "GPS2_TYPE or GPS_TYPE2 could not be read", None),
    ],
)
def test_a_wrong_parameter_stops_and_is_named_with_its_remedy(changes, words, parameter):
    (finding,) = said(with_parameters(**changes))
    assert finding.severity is Severity.STOP
    assert words in finding.text
    assert finding.parameter == parameter
    assert finding.remedy
    if parameter is not None:
        assert f"{parameter[0]} = {parameter[1]:g}" in finding.remedy


def test_the_remedy_names_the_parameter_as_the_vehicle_does():
    (finding,) = said(replace(GOOD, parameters=renamed(BEFORE_4_6) | {"GPS_TYPE2": 1.0}))
    assert finding.parameter == ("GPS_TYPE2", 14.0)
    assert finding.text.startswith("GPS_TYPE2 = 1:")


@pytest.mark.parametrize(
    ("changes", "system_id", "is_heard"),
    [
        ({"MAV_OPTIONS": 1.0}, 255, True),
        ({"MAV_OPTIONS": 1.0, "MAV_GCS_SYSID": 250.0, "MAV_GCS_SYSID_HI": 254.0}, 254, True),
        ({"MAV_OPTIONS": 1.0, "MAV_GCS_SYSID": 250.0, "MAV_GCS_SYSID_HI": 253.0}, 254, False),
        ({"MAV_OPTIONS": 2.0}, 254, True),
        ({"MAV_OPTIONS": 3.0}, 254, False),
    ],
)
def test_whom_the_vehicle_listens_to(changes, system_id, is_heard):
    assert is_ready(said(with_parameters(**changes), Setup(system_id=system_id))) is is_heard


@pytest.mark.parametrize(
    ("vehicle", "words"),
    [
        (with_parameters(GPS1_TYPE=0.0), "no receiver of its own"),
        (replace(GOOD, armed=False), "does not arm"),
        (with_parameters(GPS2_DELAY_MS=120.0), "what is sent is timed for 0.12 s"),
        (with_parameters(GPS2_DELAY_MS=0.0), "announces 0.2 s"),
        (with_parameters(EK3_SRC1_VELZ=3.0), "vertical velocity"),
        (with_parameters(AHRS_EKF_TYPE=2.0), "EKF3"),
        (with_parameters(EK3_SRC1_VELXY=6.0), "velocity"),
        (with_parameters(EK3_SRC1_POSZ=3.0), "it flies on the GPS height"),
        (replace(GOOD, receiver=replace(RECEIVER, fix_type=1, satellites=3)), "fix type 1, 3 satellites"),
        (replace(GOOD, peers=frozenset({1, 2, 3, 9})), "9, which are not heard"),
        (replace(GOOD, answers_timesync=False), "TIMESYNC"),
        (replace(GOOD, utc_minus_host_s=-40.0), "40 s behind"),
        (replace(GOOD, rates_hz=GOOD.rates_hz | {33: 2.0}), "GLOBAL_POSITION_INT comes at 2.0 Hz, 10 Hz are wanted"),
        (replace(GOOD, rates_hz={k: v for k, v in WANTED_HZ.items() if k != 124}), "GPS2_RAW is not heard"),
    ],
)
def test_what_does_not_stop_anything_is_a_note(vehicle, words):
    (finding,) = said(vehicle)
    assert finding.severity is Severity.NOTE
    assert words in finding.text


def test_a_clock_that_is_off_by_no_more_than_the_limit_is_right():
    assert not said(replace(GOOD, utc_minus_host_s=CLOCKS_AGREE_S))


def test_another_receiver_instance_is_judged_as_the_fed_one():
    swapped = with_parameters(GPS1_TYPE=14.0, GPS2_TYPE=1.0, GPS_PRIMARY=1.0, GPS1_DELAY_MS=100.0)
    assert not said(swapped, Setup(aiding=AidingSettings(gps_id=0)))
    assert not is_ready(said(swapped, Setup(aiding=AidingSettings(gps_id=1))))


@pytest.mark.parametrize(
    ("vehicle", "words"),
    [
        (replace(GOOD, autopilot=Autopilot.PX4, parameters={}), "answers nothing"),
        (replace(GOOD, autopilot=Autopilot.PX4, parameters={"EKF2_EV_NOISE_MD": 0.0}), "EKF2_EV_CTRL could not be read"),
        (replace(GOOD, autopilot=Autopilot.OTHER, parameters={}), "neither ArduPilot nor PX4"),
        (replace(GOOD, parameters={}), "answers nothing"),
        (replace(GOOD, others_there=(1, 2)), "vehicle 1, 2 (a router?)"),
        (replace(GOOD, is_claimed_twice=True, addresses=("a", "b")), "2 addresses at the same time: a, b"),
        (replace(GOOD, has_two_clocks=True), "two use its system id"),
        (replace(GOOD, peers=frozenset({1, 2})), "ranges to 2 of the 3 others that are needed to locate it: 1, 2"),
        (replace(GOOD, peers=frozenset()), "ranges to 0 of the 3"),
        (replace(GOOD, peers=frozenset({1, 2, 9})), "ranges to 2 of the 3"),
        (replace(GOOD, rates_hz={k: v for k, v in WANTED_HZ.items() if k != 33}), "GLOBAL_POSITION_INT is not heard"),
        (replace(GOOD, rates_hz={k: v for k, v in WANTED_HZ.items() if k != 24}), "GPS_RAW_INT is not heard"),
        (
            replace(GOOD, rates_hz={k: v for k, v in WANTED_HZ.items() if k != 33}, empty=frozenset({33})),
            "GLOBAL_POSITION_INT holds no position",
        ),
        (
            replace(GOOD, parameters={k: v for k, v in PARAMETERS.items() if k != "MAV_OPTIONS"}, answers_only_to=255),
            "it answers 255 and not us, 254",
        ),
    ],
)
def test_what_stops_is_said_with_words(vehicle, words):
    stops = [finding for finding in said(vehicle) if finding.severity is Severity.STOP]
    assert len(stops) == 1
    assert words in stops[0].text


def test_ranges_without_a_time_stamp_are_a_note_with_the_field_to_fill_in():
    (finding,) = [finding for finding in said(replace(GOOD, has_unstamped_ranges=True)) if "time stamp" in finding.text]
    assert finding.severity is Severity.NOTE
    assert "time_usec" in finding.remedy
    assert is_ready(said(replace(GOOD, has_unstamped_ranges=True)))
    assert not any("time stamp" in finding.text for finding in said(GOOD))


def test_a_silent_vehicle_with_signed_frames_may_want_the_key():
    (finding,) = said(replace(GOOD, parameters={}, is_signed=True))
    assert "give gcs-coloc its key" in finding.remedy


def test_the_way_that_the_configuration_sets_is_the_one_that_is_checked():
    without = with_parameters(GPS2_TYPE=0.0)
    assert not said(without, Setup(aiding=AidingSettings(method="external_position")))
    assert not said(without, Setup(aiding=AidingSettings(methods={4: "external_position"})))
    assert said(without, Setup(aiding=AidingSettings(methods={5: "external_position"})))
    (finding,) = said(GOOD, Setup(aiding=AidingSettings(method="global_position_sensor")))
    assert "ArduPilot does not take GLOBAL_POSITION_SENSOR" in finding.text
    (finding,) = said(replace(GOOD, autopilot=Autopilot.PX4), Setup(aiding=AidingSettings(method="gps_input")))
    assert "PX4 does not take GPS_INPUT" in finding.text
    (finding,) = said(replace(GOOD, autopilot=Autopilot.PX4), Setup(aiding=AidingSettings(method="external_position")))
    assert "PX4 takes an external position estimate as a reset" in finding.text


def test_an_unknown_autopilot_is_aided_as_it_is_set_and_stops_where_nothing_is():
    unknown = replace(GOOD, autopilot=Autopilot.OTHER, parameters={})
    (finding,) = said(unknown)
    assert (finding.severity, finding.remedy) == (
        Severity.STOP,
        "set method, or methods.4 for this vehicle alone, in [aiding] of gcs-coloc",
    )
    for aid in (AidingSettings(method="gps_input"), AidingSettings(methods={4: "gps_input"})):
        (finding,) = said(unknown, Setup(aiding=aid))
        assert finding.severity is Severity.NOTE
        assert "it is aided by gps_input, as set" in finding.text


def test_a_vehicle_that_is_streamed_on_standby_may_arm():
    setup = Setup(aiding=AidingSettings(standby=True))
    assert not said(replace(GOOD, armed=False), setup)
    told = [finding.text for finding in of_vehicle(replace(GOOD, armed=False), setup, FLEET)]
    assert any('it arms 10 to 30 s after the stream began; before, it says "GPS 2: not healthy"' in text for text in told)


def test_the_remedy_of_a_vehicle_that_does_not_arm_says_how_long_standby_takes():
    [finding] = said(replace(GOOD, armed=False))
    assert "with which it arms 10 to 30 s after the stream began" in finding.remedy


@pytest.mark.parametrize("autopilot", [Autopilot.ARDUPILOT, Autopilot.PX4])
def test_of_a_shared_address_doctor_and_service_say_the_same(autopilot):
    parameters = PX4_SLOT if autopilot is Autopilot.PX4 else GOOD.parameters
    findings = said(replace(GOOD, autopilot=autopilot, parameters=parameters, others_there=(1, 2)))
    [finding] = [finding for finding in findings if "a router?" in finding.text]
    assert "nor does PX4 heed a position's: all of them would use it" in finding.text
    assert "an ArduPilot can be aided there by external_position" in finding.remedy
    wording = RouteReport(4, 0.0, RouteBlock.SHARED_ADDRESS, (1, 2)).wording
    assert wording is not None
    assert wording.endswith(f"{finding.text.partition('(a router?)')[2]}; {finding.remedy}")


def test_a_vehicle_that_only_helps_is_not_held_to_what_the_located_ones_need():
    helper = replace(GOOD, sysid=1, autopilot=Autopilot.PX4, parameters={}, peers=frozenset(), others_there=(2,))
    assert is_ready(said(helper, Setup(denied=frozenset({4}))))
    assert not is_ready(said(replace(helper, rates_hz={}), Setup(denied=frozenset({4}))))
    assert not is_ready(said(replace(helper, is_claimed_twice=True), Setup(denied=frozenset({4}))))
    assert not is_ready(said(replace(helper, sysid=4), Setup(denied=frozenset({4}))))


@pytest.mark.parametrize(
    ("vehicle", "words"),
    [
        (
            with_parameters(SERIAL2_PROTOCOL=2.0, MAV1_OPTIONS=0.0),
            "set MAV1_OPTIONS = 8 on that port and reboot it",
        ),
        (with_parameters(SERIAL2_PROTOCOL=2.0, MAV1_OPTIONS=9.0), "PEER_RANGE with the peers' system ids; or say"),
        (
            replace(GOOD, autopilot=Autopilot.PX4, parameters=PX4_SLOT),
            "PX4 forwards RANGING_BEACON and DEBUG_VECT",
        ),
    ],
)
def test_where_ranges_are_expected_and_none_comes_it_is_said_what_drops_them_on_the_way(vehicle, words):
    assert words in " ".join(finding.remedy or "" for finding in said(replace(vehicle, peers=frozenset())))


def test_a_vehicle_without_an_airspeed_sensor_is_sound():
    """A quadrotor's VFR_HUD has no airspeed (NaN)."""
    rates = {number: hz for number, hz in GOOD.rates_hz.items() if number != 74}
    assert not said(replace(GOOD, rates_hz=rates, empty=frozenset({74})))
