"""The own GPS of a PX4 that is faulty is switched off in its EKF2 by command, on the rules of GPS_PRIMARY, and on again."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, fly, parameters_told, settings, texts, vehicle_4

from gcs_coloc.core.aiding.receiver_switch import ReceiverSwitch
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, PrimaryOverride
from gcs_coloc.core.messages.inbound import Autopilot, CommandOutcome, CommandResult, VehicleCommand
from gcs_coloc.core.messages.outbound import Notice, ParameterSet, SensorEnable

ENABLE, ACCEPTED = VehicleCommand.ESTIMATOR_SENSOR_ENABLE, CommandOutcome.ACCEPTED


class FaultyReceiver:
    """Vehicle 4, a PX4 whose receiver keeps its fix, and what it answers to the command."""

    def __init__(self, outcome: CommandOutcome = ACCEPTED, **aiding: object) -> None:
        self.engine = Engine(StraightLine(), settings(aiding=AidingSettings(**aiding)))
        self.outcome = outcome
        self.out: list = []
        self.fly(0.0, 2.0)
        parameters_told(self.engine, 2.0, EKF2_AGP0_CTRL=1.0, EKF2_AGP0_ID=1.0)
        self.fly(2.0, 5.0)

    def fly(self, start_s: float, stop_s: float, failed: tuple[int, ...] = ()) -> None:
        for step in range(round(start_s * 10), round(stop_s * 10)):
            for at_s, output in fly(self.engine, step / 10, step / 10 + 0.1, failed=failed, autopilot=Autopilot.PX4):
                self.out.append((at_s, output))
                if isinstance(output, SensorEnable):
                    self.engine.receive(CommandResult(4, at_s, ENABLE, self.outcome))

    @property
    def commands(self) -> list[bool]:
        return [o.gps for _, o in self.out if isinstance(o, SensorEnable)]


@pytest.mark.parametrize(("setting", "commands"), [("auto", [False]), ("off", [])])
def test_it_is_switched_off_by_setting_where_it_reports_a_fix_though_it_has_failed(setting, commands):
    flight = FaultyReceiver(switch_primary=setting)
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 12.0)
    assert flight.commands == commands
    assert not [o for _, o in flight.out if isinstance(o, ParameterSet)]
    assert vehicle_4(flight.engine, 12.0).gps_primary == ("ours" if commands else None)
    assert flight.engine.decision(4).is_self_fed is bool(commands)


def test_one_that_is_simply_gone_is_left_in_use():
    """PX4 would not go back to it by itself, should our stream end."""
    flight = FaultyReceiver(switch_primary="auto")
    flight.fly(5.0, 12.0, failed=(4,))
    assert vehicle_4(flight.engine, 12.0).gps_state == "failed"
    assert flight.commands == []


def test_the_operators_command_switches_it_off_and_on_again():
    flight = FaultyReceiver()
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 7.0)
    flight.engine.receive(OperatorCommand(4, 7.0, PrimaryOverride.OURS))
    flight.fly(7.0, 9.0)
    flight.engine.receive(OperatorCommand(4, 9.0, PrimaryOverride.OWN))
    flight.fly(9.0, 11.0)
    assert flight.commands == [False, True]
    assert "its own GPS is switched off: it flies on the position that it is sent" in texts(flight.out)
    assert "its own GPS is switched on again" in texts(flight.out)
    assert vehicle_4(flight.engine, 11.0).gps_primary is None


def test_a_firmware_that_does_not_know_the_command_is_asked_once_and_nothing_is_restored():
    flight = FaultyReceiver(CommandOutcome.UNSUPPORTED, switch_primary="auto")
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 15.0)
    assert flight.commands == [False]
    assert any("does not let its own GPS be switched off (unsupported)" in text for text in texts(flight.out))
    assert not flight.engine.decision(4).is_self_fed
    assert not [o for o in flight.engine.close() if isinstance(o, SensorEnable)]


def test_the_end_of_the_service_switches_it_on_again():
    flight = FaultyReceiver(switch_primary="auto")
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 10.0)
    assert flight.engine.close()[-1] == SensorEnable(4, gps=True)


def test_without_an_answer_it_is_tried_a_few_times_and_told():
    switch, out = ReceiverSwitch(1), []
    for at_s in range(10):
        out += switch.review(4, Autopilot.PX4, float(at_s), wanted=True)
    assert [o.gps for o in out if isinstance(o, SensorEnable)] == [False] * 5
    assert len(out) == 6
    assert switch.holds(4)  # it may have been heard


def test_a_vehicle_that_refuses_to_switch_it_on_is_not_said_to_be_silent():
    switch, sent, told = ReceiverSwitch(1), [], []
    for step in range(60):
        now_s = step / 2
        for output in switch.review(4, Autopilot.PX4, now_s, wanted=now_s < 2.0):
            if isinstance(output, Notice):
                told.append((output.level, output.text))
            else:
                sent.append(output.gps)
                outcome = CommandOutcome.DENIED if output.gps else ACCEPTED
                told += [(n.level, n.text) for n in switch.add_answer(CommandResult(4, now_s, ENABLE, outcome))]
    assert sent == [False, *[True] * 5]
    assert told[1:] == [("error", "it does not let its own GPS be switched on (denied); tried again in 30 s")]
    assert switch.holds(4)
