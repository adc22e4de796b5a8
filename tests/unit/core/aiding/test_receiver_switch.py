"""GPS_PRIMARY: read, set, confirmed, restored; each step tried a few times and told."""

from __future__ import annotations

from gcs_coloc.core.aiding.receiver_switch import ReceiverSwitch
from gcs_coloc.core.messages.inbound import Autopilot, ParameterValue
from gcs_coloc.core.messages.outbound import Notice, ParameterRequest, ParameterSet

ARDUPILOT, INT8 = Autopilot.ARDUPILOT, 2


class Aircraft:
    """An autopilot that keeps the parameter and answers, while it hears."""

    def __init__(self, primary: float = 0.0) -> None:
        self.primary = primary
        self.hears = self.takes = True

    def answer(self, message, now_s: float) -> list[ParameterValue]:
        if not self.hears:
            return []
        if isinstance(message, ParameterSet):
            assert message.kind == INT8
            self.primary = message.value if self.takes else self.primary
        return [ParameterValue(4, now_s, "GPS_PRIMARY", self.primary, INT8)]


def run(switch: ReceiverSwitch, aircraft: Aircraft, start_s: float, stop_s: float, *, wanted: bool) -> tuple[list, list[str]]:
    sent, told = [], []
    for step in range(round(start_s * 5), round(stop_s * 5)):
        now_s = step / 5
        queue = switch.review(4, ARDUPILOT, now_s, wanted=wanted)
        while queue:
            output = queue.pop(0)
            if isinstance(output, Notice):
                told.append(output.text)
            else:
                sent.append(output)
                for value in aircraft.answer(output, now_s + 0.05):
                    queue += switch.add_answer(value)
    return sent, told


def test_it_is_read_set_and_confirmed_then_restored_to_what_it_was():
    switch, aircraft = ReceiverSwitch(1), Aircraft(0.0)
    sent, told = run(switch, aircraft, 0.0, 5.0, wanted=True)
    assert sent == [ParameterRequest(4, "GPS_PRIMARY"), ParameterSet(4, "GPS_PRIMARY", 1.0, INT8)]
    assert told == ["GPS_PRIMARY set to 1, our receiver; it was 0"]
    assert switch.holds(4)
    sent, told = run(switch, aircraft, 5.0, 10.0, wanted=False)
    assert sent == [ParameterSet(4, "GPS_PRIMARY", 0.0, INT8)]
    assert told == ["GPS_PRIMARY restored to 0"]
    assert (aircraft.primary, switch.holds(4), switch.status(4)) == (0.0, False, None)


def test_nothing_is_sent_where_nothing_is_wanted():
    assert run(ReceiverSwitch(1), Aircraft(), 0.0, 5.0, wanted=False) == ([], [])


def test_one_that_is_ours_already_is_left_and_never_restored():
    switch, aircraft = ReceiverSwitch(1), Aircraft(1.0)
    sent, told = run(switch, aircraft, 0.0, 5.0, wanted=True)
    assert sent == [ParameterRequest(4, "GPS_PRIMARY")]
    assert told == ["GPS_PRIMARY is 1 already: left as it is"]
    assert run(switch, aircraft, 5.0, 10.0, wanted=False) == ([], [])


def test_a_silent_vehicle_is_asked_five_times_then_told_of_and_again_after_half_a_minute():
    switch, aircraft = ReceiverSwitch(1), Aircraft()
    aircraft.hears = False
    sent, told = run(switch, aircraft, 0.0, 30.0, wanted=True)
    assert len(sent) == 5
    assert told == ["GPS_PRIMARY could not be read: no answer; tried again in 30 s"]
    assert not switch.holds(4)
    aircraft.hears = True
    assert run(switch, aircraft, 30.0, 40.0, wanted=True)[1] == ["GPS_PRIMARY set to 1, our receiver; it was 0"]


def test_a_set_that_nobody_confirmed_may_have_been_applied_and_is_restored():
    switch, aircraft = ReceiverSwitch(1), Aircraft()
    (request,) = switch.review(4, ARDUPILOT, 0.0, wanted=True)
    switch.add_answer(aircraft.answer(request, 0.1)[0])
    (order,) = switch.review(4, ARDUPILOT, 0.2, wanted=True)
    assert isinstance(order, ParameterSet)
    assert switch.holds(4)  # the answer is lost
    sent, told = run(switch, aircraft, 1.0, 5.0, wanted=False)
    assert sent == [ParameterSet(4, "GPS_PRIMARY", 0.0, INT8)]
    assert told == ["GPS_PRIMARY restored to 0"]


def test_one_that_cannot_be_restored_is_told_with_the_value_and_tried_on():
    switch, aircraft = ReceiverSwitch(1), Aircraft()
    run(switch, aircraft, 0.0, 5.0, wanted=True)
    aircraft.hears = False
    sent, told = run(switch, aircraft, 5.0, 35.0, wanted=False)
    assert len(sent) == 5
    assert told == ["GPS_PRIMARY could not be restored to 0, which can be done by hand: no answer; tried again in 30 s"]
    assert switch.holds(4)
    aircraft.hears = True
    assert run(switch, aircraft, 35.0, 45.0, wanted=False)[1] == ["GPS_PRIMARY restored to 0"]


def test_what_somebody_else_sets_meanwhile_is_left():
    switch, aircraft = ReceiverSwitch(1), Aircraft()
    run(switch, aircraft, 0.0, 5.0, wanted=True)
    (notice,) = switch.add_answer(ParameterValue(4, 5.0, "GPS_PRIMARY", 0.0, INT8))
    assert notice.text == "GPS_PRIMARY was set to 0 by somebody else: left as it is"
    assert run(switch, aircraft, 5.0, 10.0, wanted=True) == ([], [])
    assert not switch.holds(4)


def test_the_end_of_the_service_restores_it():
    switch, aircraft = ReceiverSwitch(1), Aircraft()
    run(switch, aircraft, 0.0, 5.0, wanted=True)
    assert switch.close() == [ParameterSet(4, "GPS_PRIMARY", 0.0, INT8)]
    assert switch.close() == []


def test_a_value_that_stays_as_it_is_is_told_as_such():
    switch, aircraft = ReceiverSwitch(1), Aircraft()
    aircraft.takes = False
    assert run(switch, aircraft, 0.0, 10.0, wanted=True)[1] == [
        "GPS_PRIMARY could not be set to 1: it stays 0; tried again in 30 s"
    ]
