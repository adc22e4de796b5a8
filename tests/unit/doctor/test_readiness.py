"""What the doctor says of a vehicle's readiness, and where it has it from."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState, VehicleReadiness
from gcs_coloc.doctor.finding import Setup, Severity
from gcs_coloc.doctor.report import of_vehicle
from gcs_coloc.doctor.survey import Survey
from gcs_coloc.estimators.fleet.filter import FleetFilter
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
from tests.fleet_views import NOT_READY, READY
from tests.signed_frames import Signer
from tests.vehicle_surveys import FLEET, GOOD

DEGRADED = replace(READY, state=ReadinessState.DEGRADED, reason="not_tested", text="the ranges cannot test the position of 2")


def told(readiness: VehicleReadiness | None) -> list[tuple[Severity, str, str | None]]:
    findings = of_vehicle(replace(GOOD, readiness=readiness), Setup(), FLEET)
    return [(f.severity, f.text, f.remedy) for f in findings if "if its GPS failed" in f.text]


def test_a_ready_vehicle_is_right_with_its_levels() -> None:
    [(severity, text, _)] = told(READY)
    assert severity is Severity.RIGHT
    assert text.endswith("it would be located within 2.2 m (95 %), protection level 14 m")


@pytest.mark.parametrize(("readiness", "words"), [(DEGRADED, "but the ranges cannot"), (NOT_READY, "it would be lost: peers 2")])
def test_what_limits_it_is_a_note_with_a_remedy(readiness: VehicleReadiness, words: str) -> None:
    [(severity, text, remedy)] = told(readiness)
    assert severity is Severity.NOTE
    assert words in text
    assert remedy is not None
    assert "gcs-coloc plan" in remedy


def test_what_other_checks_tell_is_not_told_twice() -> None:
    assert told(None) == []
    assert told(replace(NOT_READY, peers=0)) == []
    assert told(replace(NOT_READY, reason="not_aided")) == []


PLACES = {1: (0.0, 0.0), 2: (60.0, 5.0), 3: (-30.0, 50.0), 4: (-25.0, -55.0)}
M_PER_DEGREE_N, M_PER_DEGREE_E = 111_200.0, 76_000.0


def survey_of(estimator: object) -> VehicleReadiness | None:
    """Four vehicles on the ground for 15 s; the first ranges the others twice a second. Return its readiness."""
    engine = Engine(estimator, EngineSettings())  # type: ignore[arg-type]
    survey = Survey((254, 191), 0.0, 15.0, utc_minus_service_s=None, asks_for_streams=False, engine=engine)
    senders = {sysid: Signer(sysid) for sysid in PLACES}
    for step in range(150):
        at_s, boot_ms = step / 10.0, 1000 + 100 * step
        for sysid, (e, n) in PLACES.items():
            lat, lon = round((47.0 + n / M_PER_DEGREE_N) * 1e7), round((8.0 + e / M_PER_DEGREE_E) * 1e7)
            messages = [mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, 500_000, 0, 0, 0, 0, 0)]
            if step % 10 == 0:
                messages.append(mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3))
            if step % 2 == 0:
                accuracy = {"h_acc": 900, "v_acc": 1500, "vel_acc": 200}
                messages.append(
                    mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, 3, lat, lon, 500_000, 80, 90, 0, 0, 12, **accuracy)
                )
            if step % 5 == 0 and sysid == 1:
                for other in (2, 3, 4):
                    metres = math.dist(PLACES[1], PLACES[other])
                    messages.append(mavlink.MAVLink_debug_vect_message(f"RNG{other}".encode(), boot_ms * 1000, metres, 0.3, -1.0))
            for message in messages:
                survey.receive(senders[sysid].pack(message), f"address of {sysid}", at_s)
    names = {f"address of {sysid}": f"<{sysid}>" for sysid in PLACES}
    return next(v.readiness for v in survey.findings(names, host_is_synchronised=True).vehicles if v.sysid == 1)


def test_the_engine_of_the_flight_tells_it_from_what_is_heard() -> None:
    readiness = survey_of(FleetFilter())
    assert readiness is not None
    assert (readiness.state, readiness.peers) == (ReadinessState.READY, 3)
    assert not readiness.is_lost


def test_an_estimator_that_predicts_nothing_is_told() -> None:
    readiness = survey_of(QuZhangFilter())
    assert readiness is not None
    [(severity, text, _)] = told(readiness)
    assert severity is Severity.NOTE
    assert "the estimator qu_zhang predicts no loss of GPS" in text
