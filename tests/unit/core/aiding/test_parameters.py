"""Parameters are asked for a few times, not for ever, and anew when they may have changed."""

from __future__ import annotations

from gcs_coloc.core.aiding.parameters import Parameters
from gcs_coloc.core.messages.inbound import ParameterValue
from gcs_coloc.core.messages.outbound import ParameterRequest


def asked_over(
    parameters: Parameters, start_s: float, stop_s: float, *, want: bool = True
) -> list[tuple[float, ParameterRequest]]:
    out = []
    for step in range(round(start_s * 5), round(stop_s * 5)):
        now_s = step / 5
        if want:
            parameters.request(4, "EK3_GPS_CHECK", now_s)
        out.extend((now_s, request) for request in parameters.due(now_s))
    return out


def test_a_silent_vehicle_is_asked_three_times_and_again_after_half_a_minute():
    times = [t for t, _ in asked_over(Parameters(), 0.0, 40.0)]
    assert times == [0.0, 1.0, 2.0, 33.0, 34.0, 35.0]


def test_it_counts_as_asked_for_in_vain_once_the_last_question_has_had_its_time():
    parameters = Parameters()
    assert [t for t, _ in asked_over(parameters, 0.0, 3.0)] == [0.0, 1.0, 2.0]
    assert not parameters.is_settled(4, "EK3_GPS_CHECK")
    asked_over(parameters, 3.0, 3.2)
    assert parameters.is_settled(4, "EK3_GPS_CHECK")


def test_an_answer_ends_the_questions_until_it_is_old():
    parameters = Parameters()
    assert asked_over(parameters, 0.0, 1.0) == [(0.0, ParameterRequest(4, "EK3_GPS_CHECK"))]
    parameters.add(ParameterValue(4, 1.0, "EK3_GPS_CHECK", 19.0, 4))
    assert parameters.value(4, "EK3_GPS_CHECK") == 19.0
    assert asked_over(parameters, 1.0, 31.0) == []
    assert [t for t, _ in asked_over(parameters, 31.0, 32.0)] == [31.0]
    assert parameters.value(4, "EK3_GPS_CHECK") == 19.0


def test_nothing_is_asked_that_nobody_wants_and_nothing_kept_that_nobody_asked():
    parameters = Parameters()
    parameters.add(ParameterValue(4, 0.0, "EK3_GPS_CHECK", 19.0, 4))
    assert parameters.value(4, "EK3_GPS_CHECK") is None
    assert asked_over(parameters, 0.0, 10.0, want=False) == []


def test_a_change_that_the_vehicle_tells_by_itself_is_taken():
    parameters = Parameters()
    asked_over(parameters, 0.0, 1.0)
    for value in (31.0, 23.0):
        parameters.add(ParameterValue(4, 1.0, "EK3_GPS_CHECK", value, 4))
    assert parameters.value(4, "EK3_GPS_CHECK") == 23.0


def test_a_reboot_makes_it_unknown_for_that_vehicle_alone():
    parameters = Parameters()
    for sysid in (3, 4):
        parameters.request(sysid, "EK3_GPS_CHECK", 0.0)
        parameters.add(ParameterValue(sysid, 0.0, "EK3_GPS_CHECK", 31.0, 4))
    parameters.forget(4)
    assert (parameters.value(3, "EK3_GPS_CHECK"), parameters.value(4, "EK3_GPS_CHECK")) == (31.0, None)
    assert [t for t, _ in asked_over(parameters, 5.0, 5.4)] == [5.0]
