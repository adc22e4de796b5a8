"""GPS_PRIMARY in flight: when it is set to our receiver, what the reports count for meanwhile, and how it is restored."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, fly, settings, texts, vehicle_4

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.control import GpsOverride, OperatorCommand, PrimaryOverride
from gcs_coloc.core.messages.inbound import GpsReceiver, ParameterValue
from gcs_coloc.core.messages.outbound import GpsInput, ParameterRequest, ParameterSet


class Switching:
    """Vehicle 4 with GPS2_RAW heard as it is sent, a parameter that it keeps, and the fix type that its own receiver reports."""

    def __init__(self, **aid) -> None:
        self.engine = Engine(StraightLine(), settings(aiding=AidingSettings(**aid)))
        self.primary = 0.0
        self.out: list = []
        fly(self.engine, 0.0, 5.0)

    def fly(self, start_s: float, stop_s: float, failed: list[int]) -> None:
        for step in range(round(start_s * 10), round(stop_s * 10)):
            t = step / 10
            for at_s, output in fly(self.engine, t, t + 0.1, failed=failed):
                self.out.append((at_s, output))
                if isinstance(output, GpsInput) and output.sysid == 4:
                    place = (output.lat_deg, output.lon_deg, output.alt_msl_m)
                    self.engine.receive(GpsReceiver(4, at_s, 1, output.fix_type, *place, 7, 1.0, 2.0, 3.0, 0.5))
                if isinstance(output, ParameterSet):
                    self.primary = output.value
                if isinstance(output, ParameterSet | ParameterRequest) and output.name == "GPS_PRIMARY":
                    self.engine.receive(ParameterValue(4, at_s, "GPS_PRIMARY", self.primary, 2))


@pytest.mark.parametrize(("setting", "expected"), [("auto", 1.0), ("off", 0.0)])
def test_the_primary_receiver_is_switched_by_setting_only_where_the_own_one_has_failed_and_reports_a_fix(setting, expected):
    flight = Switching(switch_primary=setting)
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 12.0, failed=[])  # its own receiver has a fix all the time
    assert flight.primary == expected


@pytest.mark.parametrize(("setting", "expected"), [("auto", 1.0), ("off", 0.0)])
def test_a_receiver_without_a_fix_is_left_before_it_has_a_false_one(setting, expected):
    """A jammed one has its first false fix seconds after the loss, and the EKF follows that at once."""
    flight = Switching(switch_primary=setting)
    flight.fly(5.0, 12.0, failed=[4])
    assert flight.primary == expected


def test_one_that_is_back_is_restored_once_it_is_healthy():
    flight = Switching(switch_primary="auto")
    flight.fly(5.0, 12.0, failed=[4])
    flight.fly(12.0, 21.0, failed=[])
    assert flight.primary == 1.0
    flight.fly(21.0, 24.0, failed=[])
    assert flight.primary == 0.0


def test_while_the_primary_receiver_is_ours_its_reports_are_an_echo_until_it_is_restored():
    flight = Switching(switch_primary="auto")
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 12.0, failed=[])
    assert vehicle_4(flight.engine, 12.0).gps_primary == "ours"
    estimator = flight.engine.estimator._inner
    flight.engine.receive(OperatorCommand(4, 12.0, GpsOverride.HEALTHY))
    assert flight.engine.decision(4).is_self_fed
    flight.fly(12.0, 13.0, failed=[])
    assert flight.primary == 0.0
    assert "GPS_PRIMARY restored to 0" in texts(flight.out)
    assert min(m.measured_at_s for m in estimator.of(PositionMeasurement, 4) if m.measured_at_s > 6.0) > 12.0


def test_the_operators_word_switches_and_restores_it():
    flight = Switching()
    flight.fly(5.0, 8.0, failed=[4])
    flight.engine.receive(OperatorCommand(4, 8.0, PrimaryOverride.OURS))
    flight.fly(8.0, 10.0, failed=[4])
    assert flight.primary == 1.0
    flight.engine.receive(OperatorCommand(4, 10.0, PrimaryOverride.OWN))
    flight.fly(10.0, 12.0, failed=[4])
    assert flight.primary == 0.0


def test_it_is_not_switched_to_a_receiver_that_is_not_seen_to_take_what_is_sent():
    engine = Engine(StraightLine(), settings(aiding=AidingSettings(switch_primary="auto")))
    engine.receive(OperatorCommand(4, 0.0, GpsOverride.FAILED))
    out = fly(engine, 0.0, 10.0)  # no GPS2_RAW
    assert not [o for _, o in out if isinstance(o, ParameterRequest) and o.name == "GPS_PRIMARY"]


def test_the_end_of_the_service_restores_it_after_the_last_no_fix():
    flight = Switching(switch_primary="auto")
    flight.engine.receive(OperatorCommand(4, 5.0, GpsOverride.FAILED))
    flight.fly(5.0, 12.0, failed=[])
    last = flight.engine.close()
    assert isinstance(last[0], GpsInput)
    assert last[0].fix_type == 1
    assert last[1:] == [ParameterSet(4, "GPS_PRIMARY", 0.0, 2)]
