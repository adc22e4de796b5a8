"""What is published of a fleet over MQTT is what its view says."""

from dataclasses import replace

import pytest
from fleet_views import HEALTHY, LOCATED, NOT_READY, READY, fleet_view

from gcs_coloc.sinks.mqtt_models import of_vehicle, status


def test_the_status_holds_the_ground_tools_and_the_last_will_none():
    (out,) = status(fleet_view(10.0), online=True).model_dump()["outs"]
    assert out == {
        "name": "udpout:127.0.0.1:14551",
        "tools": 1,
        "frames_sent": 400,
        "frames_accepted": 12,
        "dropped": 3,
        "refused": 2,
    }
    assert status(None, online=False).outs == ()


@pytest.mark.parametrize("readiness", [READY, NOT_READY])
def test_readiness_is_published_as_it_was_found(readiness):
    told = of_vehicle(replace(HEALTHY, readiness=readiness), 1.0)["readiness"].model_dump()
    assert told.pop("at_unix_s") == 1.0
    assert told.pop("sysid") == 1
    assert told == {name: getattr(readiness, name) for name in told}
    assert len(told) == 11


def test_without_healthy_gps_there_is_none_to_publish():
    told = of_vehicle(LOCATED, None)["readiness"].model_dump()
    assert told.pop("sysid") == LOCATED.sysid
    assert told.pop("text") == ""
    assert set(told.values()) == {None}
