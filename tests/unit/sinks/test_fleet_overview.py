"""What one message tells of a fleet is what its view says, and nothing that JSON cannot hold."""

import math
from dataclasses import replace

import pytest
from fleet_views import HEALTHY, LOCATED, LOST, fleet_view
from pydantic import ValidationError

from gcs_coloc.core.alarms.alarms import AlarmList
from gcs_coloc.sinks.fleet_overview import FleetOverview, fleet_overview


def told(*vehicles, **other):
    snapshot, alarms = fleet_view(10.0, *vehicles, **other), AlarmList()
    alarms.update(snapshot)
    return fleet_overview(snapshot, alarms, host="alpha", every_s=1.0)


def test_each_vehicle_has_its_light_with_the_reason_and_its_position():
    healthy, located, lost = told(HEALTHY, LOCATED, replace(LOST, sysid=5)).vehicles
    assert [v.light for v in (healthy, located, lost)] == ["good", "caution", "bad"]
    assert (healthy.lat_deg, healthy.lon_deg, located.bound_95_m, located.aiding_has_fix) == (47.0, 8.0, 6.6, True)
    assert "no ranges for 12 s" in lost.reason
    assert (lost.lat_deg, lost.hpl_m) == (None, None)


def test_the_alarms_of_the_list_are_told():
    found = {(alarm.sysid, alarm.kind, alarm.level) for alarm in told(HEALTHY, LOCATED, replace(LOST, sysid=5)).alarms}
    assert found == {(4, "gps_lost", "warning"), (5, "gps_lost", "error")}


def test_the_time_is_told_where_the_host_knows_it():
    assert told().at_unix_s is None
    assert told(utc_minus_service_s=1000.0).at_unix_s == 1010.0


def test_a_number_that_json_cannot_hold_is_unknown():
    (vehicle,) = told(replace(HEALTHY, hpl_m=math.inf, bound_95_m=math.nan)).vehicles
    assert (vehicle.hpl_m, vehicle.bound_95_m) == (None, None)


def test_what_is_sent_is_read_again_and_fields_of_a_newer_version_are_passed_over():
    text = told().model_dump_json()
    assert FleetOverview.model_validate_json(text.replace('"host":', '"since_version_9":[1],"host":')) == told()


@pytest.mark.parametrize("wrong", ['"age_s":NaN', '"age_s":"soon"', '"light":"purple"'])
def test_impossible_values_are_refused(wrong):
    text = told(HEALTHY).model_dump_json().replace('"age_s":0.1' if "age" in wrong else '"light":"good"', wrong)
    assert wrong in text
    with pytest.raises(ValidationError):
        FleetOverview.model_validate_json(text)
