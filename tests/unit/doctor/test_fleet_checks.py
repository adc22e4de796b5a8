"""The checks of a fleet: who is heard, from whom ranges come, what is refused, and whether the clock is right."""

from __future__ import annotations

from dataclasses import replace

import pytest
from vehicle_surveys import FLEET, GOOD, PARAMETERS

from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.doctor.finding import FleetSurvey, Setup, Severity
from gcs_coloc.doctor.report import OFTEN, Report, of_fleet, of_vehicle


def fleet(**changes):
    return FleetSurvey(15.0, tuple(replace(GOOD, sysid=sysid, peers=FLEET - {sysid}) for sysid in sorted(FLEET)), **changes)


@pytest.mark.parametrize(
    ("findings", "setup", "severity", "words"),
    [
        (FleetSurvey(15.0), Setup(), Severity.STOP, "no vehicle was heard in 15 s"),
        (FleetSurvey(15.0, refused={"garbage_bytes": 900}), Setup(), Severity.STOP, "in 15 s, but 900 bytes that are no MAVLink"),
        (FleetSurvey(15.0, (GOOD,)), Setup(), Severity.STOP, "vehicles heard: 1; to locate one, 3 others are needed"),
        (fleet(), Setup(denied=frozenset({4, 9})), Severity.STOP, "vehicle 9, which is to be located, was not heard"),
        (fleet(refused={"signature_wrong": OFTEN}), Setup(), Severity.NOTE, f"{OFTEN} times refused (signature_wrong)"),
        (fleet(host_is_synchronised=False), Setup(), Severity.NOTE, "not synchronised"),
        (fleet(host_is_synchronised=False), Setup(requires_synchronised_clock=True), Severity.STOP, "not synchronised"),
    ],
)
def test_what_is_said_of_the_fleet(findings, setup, severity, words):
    (finding,) = [finding for finding in of_fleet(findings, setup) if finding.severity is not Severity.RIGHT]
    assert finding.severity is severity
    assert words in finding.text


def test_a_fleet_that_is_all_right():
    findings = fleet(refused={"signature_wrong": OFTEN - 1, "not_wanted": 1000}, host_is_synchronised=True)
    assert all(finding.severity is Severity.RIGHT for finding in of_fleet(findings, Setup()))
    report = Report(findings, Setup())
    assert report.is_ready
    assert list(report.lines())[-1] == "result: all right; co-localisation can work"
    assert report.as_json()["ready"] is True


def test_stations_locate_a_vehicle_as_others_do_and_one_without_a_position_is_told():
    placed = frozenset(station_node(i) for i in (0, 1, 2))
    alone = replace(GOOD, peers=placed | {station_node(7)})
    told = [f.text + (f.remedy or "") for f in of_vehicle(alone, Setup(), frozenset({GOOD.sysid}) | placed)]
    assert "ranges to 3 others: station 0, station 1, station 2" in told
    assert any("ranges to station 7, whose position nobody tells" in text and "[[station]]" in text for text in told)
    survey = FleetSurvey(15.0, (GOOD,), stations=placed)
    assert [f.text for f in of_fleet(survey, Setup())] == ["vehicles heard: 1, fixed stations with a position: 3"]


def test_the_report_says_what_stops_first_and_whom_it_stops_last():
    good = fleet()
    wrong = replace(good.vehicles[1], parameters=PARAMETERS | {"GPS2_TYPE": 0.0})
    report = Report(replace(good, vehicles=(good.vehicles[0], wrong, *good.vehicles[2:])), Setup())
    lines = list(report.lines())
    of_two = lines.index("vehicle 2: ArduPilot, armed")
    assert lines[of_two + 1].startswith("  STOP   GPS2_TYPE = 0:")
    assert lines[of_two + 1].endswith("; set GPS2_TYPE = 14")
    assert lines[-1] == "result: something would stop co-localisation of vehicle 2"
    vehicle = report.as_json()["vehicles"][1]
    assert (vehicle["sysid"], vehicle["ready"]) == (2, False)
    assert {"GPS2_TYPE": 14.0} in [finding["set"] for finding in vehicle["findings"]]
