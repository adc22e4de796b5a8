"""An engine that is held back decides as ever and changes no vehicle; then it goes on where the other one was."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, aids, fly, settings, telemetry, vehicle_4

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import (
    AidingOverride,
    GpsOverride,
    HoldBack,
    OperatorCommand,
    SwitchedByOther,
    SwitchedReceiver,
)
from gcs_coloc.core.messages.inbound import Autopilot, CommandOutcome, CommandResult, ParameterValue, VehicleCommand
from gcs_coloc.core.messages.outbound import ChangesVehicle, Notice, ParameterRequest, ParameterSet, SensorEnable

BEFORE = SwitchedReceiver(4, 2.0, 9)


def held_back(autopilot: Autopilot = Autopilot.ARDUPILOT, **aid) -> Engine:
    """An engine with vehicle 4 without GPS, held back from the beginning."""
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(**aid)))
    engine.receive(HoldBack(0.0, held=True))
    fly(engine, 0.0, 5.0, autopilot=autopilot)
    return engine


def test_nothing_that_changes_a_vehicle_is_sent_and_the_next_fix_comes_with_the_release():
    engine = held_back()
    out = fly(engine, 5.0, 12.0, failed=[4])
    assert engine.aiding.has_stream(4)
    assert engine.aiding.to_change() == {4}
    assert not [o for _, o in out if isinstance(o, ChangesVehicle)]
    assert [o for _, o in out if isinstance(o, ParameterRequest)]  # to ask changes nothing
    assert vehicle_4(engine, 12.0).aiding.startswith("by the other service; here sending 3D fix")
    engine.receive(HoldBack(12.0, held=False))
    released = fly(engine, 12.0, 12.5, failed=[4])
    first_s, first = aids(released, 4)[0]
    assert first_s <= 12.1
    assert first.fix_type == 3


def test_what_is_sent_then_is_what_an_engine_that_was_never_held_back_sends():
    held, free = held_back(), Engine(StraightLine(), settings(aiding=AidingSettings()))
    fly(free, 0.0, 5.0)
    fly(held, 5.0, 12.0, failed=[4])
    fly(free, 5.0, 12.0, failed=[4])
    held.receive(HoldBack(12.0, held=False))
    assert aids(fly(held, 12.0, 14.0, failed=[4]), 4) == aids(fly(free, 12.0, 14.0, failed=[4]), 4)


def test_the_end_of_a_service_that_is_held_back_changes_nothing():
    engine = held_back()
    fly(engine, 5.0, 12.0, failed=[4])
    engine.receive(SwitchedByOther(12.0, BEFORE, held=True))
    assert engine.close() == []


def test_no_switch_is_begun_while_held_back_though_the_vehicle_would_answer():
    engine = held_back(switch_primary="auto")
    engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    fly(engine, 5.0, 10.0)
    engine.receive(ParameterValue(4, 10.0, "GPS_PRIMARY", 0.0, 9))
    assert engine.aiding.switched() == ()
    assert vehicle_4(engine, 10.0).gps_primary is None


def test_a_parameter_that_the_other_one_switched_is_restored_to_what_it_was():
    engine = held_back(switch_primary="auto")
    fly(engine, 5.0, 10.0, failed=[4])
    engine.receive(SwitchedByOther(10.0, BEFORE, held=True))
    assert engine.aiding.switched() == (BEFORE,)
    engine.receive(HoldBack(10.0, held=False))
    fly(engine, 10.0, 12.0, failed=[4])
    engine.receive(OperatorCommand(4, 12.0, GpsOverride.HEALTHY))
    out = fly(engine, 12.0, 22.0)
    assert ParameterSet(4, "GPS_PRIMARY", 2.0, 9) in [o for _, o in out]
    engine.receive(ParameterValue(4, 22.0, "GPS_PRIMARY", 2.0, 9))
    assert engine.aiding.switched() == ()


def test_a_gps_that_the_other_one_switched_off_by_command_is_switched_on():
    engine = held_back(Autopilot.PX4)
    engine.receive(SwitchedByOther(5.0, SwitchedReceiver(4), held=True))
    engine.receive(HoldBack(5.0, held=False))
    out = fly(engine, 5.0, 6.0, autopilot=Autopilot.PX4)
    assert SensorEnable(4, gps=True) in [o for _, o in out]
    engine.receive(CommandResult(4, 6.0, VehicleCommand.ESTIMATOR_SENSOR_ENABLE, CommandOutcome.ACCEPTED))
    assert engine.aiding.switched() == ()


def test_what_the_other_one_has_restored_is_forgotten():
    engine = held_back()
    engine.receive(SwitchedByOther(5.0, BEFORE, held=True))
    engine.receive(SwitchedByOther(6.0, BEFORE, held=False))
    assert engine.aiding.switched() == ()


@pytest.mark.parametrize("held", [True, False])
def test_overrides_in_force_are_told(held):
    engine = Engine(StraightLine(), settings())
    engine.receive(HoldBack(0.0, held=held))
    for message in telemetry(4, 0.0):
        engine.receive(message)
    engine.receive(OperatorCommand(4, 1.0, GpsOverride.FAILED))
    assert [(o.sysid, o.override) for o in engine.overrides()] == [(4, GpsOverride.FAILED)]
    engine.receive(OperatorCommand(4, 2.0, GpsOverride.AUTO))
    assert engine.overrides() == ()


def told(out) -> list[tuple[str, str]]:
    """Level and text of what is told of vehicle 4's aid."""
    return [(o.level, o.text) for _, o in out if isinstance(o, Notice) and o.sysid == 4 and "clock" not in o.text]


def test_what_a_vehicle_is_sent_is_told_by_the_service_that_sends_it():
    engine = held_back()
    before = told(fly(engine, 5.0, 12.0, failed=[4]))
    assert not [text for _, text in before if "sending" in text]
    engine.receive(HoldBack(12.0, held=False))
    assert told(fly(engine, 12.0, 13.0, failed=[4])).count(("info", "located: sending positions")) == 1
    engine.receive(HoldBack(13.0, held=True))
    engine.receive(OperatorCommand(4, 13.0, AidingOverride.OFF))
    assert not engine.aiding.has_stream(4)
    assert not [text for _, text in told(fly(engine, 13.0, 14.0, failed=[4])) if "aiding ended" in text]


def test_a_service_that_takes_over_without_an_estimate_says_that_it_sends_none():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    engine.receive(HoldBack(0.0, held=True))
    fly(engine, 0.0, 5.0)
    estimator.unknown = "no ranges"
    assert not [text for _, text in told(fly(engine, 5.0, 12.0, failed=[4])) if "not located" in text]
    engine.receive(HoldBack(12.0, held=False))
    [(level, text)] = [one for one in told(fly(engine, 12.0, 13.0, failed=[4])) if "not located" in one[1]]
    assert level == "warning"
    assert text.startswith("not located, sending no fix: ")


def test_whether_a_fix_is_taken_is_judged_by_what_this_service_sends_alone():
    """While the other one feeds nobody yet, or sends another position, the vehicle's receiver shows no fix of ours."""
    engine = held_back()
    heard = fly(engine, 5.0, 15.0, failed=[4])
    assert not [text for _, text in told(heard) if "not taken" in text]
    assert vehicle_4(engine, 15.0).fix_acknowledged is None
    engine.receive(HoldBack(15.0, held=False))
    out = fly(engine, 15.0, 22.0, failed=[4])
    [at_s] = [t for t, o in out if isinstance(o, Notice) and "GPS_INPUT is not taken" in o.text]
    assert at_s == pytest.approx(20.0, abs=0.5)


def test_that_ranges_have_ceased_is_told_with_the_release():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    engine.receive(HoldBack(0.0, held=True))
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 10.0, failed=[4])
    estimator.ranges_in_use = 0
    assert not [text for _, text in told(fly(engine, 10.0, 13.0, failed=[4])) if "ranges have ceased" in text]
    engine.receive(HoldBack(13.0, held=False))
    released = told(fly(engine, 13.0, 13.5, failed=[4]))
    assert [level for level, text in released if "ranges have ceased" in text and "sent for 7 s more" in text] == ["error"]


def test_what_keeps_a_service_from_aiding_is_its_own_until_it_is_the_one_to_send():
    engine = Engine(StraightLine(), settings())
    engine.receive(HoldBack(0.0, held=True))
    fly(engine, 0.0, 5.0, autopilot=Autopilot.OTHER)
    warned = told(fly(engine, 5.0, 8.0, failed=[4], autopilot=Autopilot.OTHER))
    [(level, text)] = [one for one in warned if "aid" in one[1]]
    assert (level, text.split(":")[0]) == ("warning", "needs aid, and this service could not aid it")
    assert vehicle_4(engine, 8.0).aiding.startswith("not by this service: its autopilot is neither")
    engine.receive(HoldBack(8.0, held=False))
    [(level, text)] = [one for one in told(fly(engine, 8.0, 10.0, failed=[4], autopilot=Autopilot.OTHER)) if "aid" in one[1]]
    assert (level, text.split(":")[0]) == ("error", "needs aid and cannot be aided")
    assert vehicle_4(engine, 10.0).aiding.startswith("NOT SENT: its autopilot is neither")
