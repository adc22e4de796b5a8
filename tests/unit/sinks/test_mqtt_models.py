"""What is published of a fleet over MQTT is what its view says."""

from fleet_views import fleet_view

from gcs_coloc.sinks.mqtt_models import status


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
