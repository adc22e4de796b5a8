"""What a vehicle is requested to send, and when."""

from gcs_coloc.core.messages.inbound import Autopilot, GlobalPosition, Heartbeat
from gcs_coloc.core.telemetry.stream_requests import WANTED_HZ, StreamRequests


def requested_ids(requests: StreamRequests, now_s: float) -> set[int]:
    return {request.message_id for request in requests.due(now_s)}


def test_a_vehicle_that_sends_heartbeats_alone_is_requested_to_send_everything():
    """Real ArduCopters do by default: their stream rates are 0."""
    requests = StreamRequests()
    for second in range(5):
        requests.add(Heartbeat(3, float(second), Autopilot.ARDUPILOT, armed=False, winged=False))
    assert requested_ids(requests, 4.0) == set(WANTED_HZ)


def test_heartbeats_alone_after_a_reboot_are_answered_with_requests_again():
    requests = StreamRequests()
    requests.add(GlobalPosition(3, 0.0, 100.0, 47.0, 8.0, 500.0, 0.0, 0.0, 0.0))
    assert requested_ids(requests, 4.0) == set(WANTED_HZ)
    requests.forget(3)
    assert requested_ids(requests, 9.0) == set()
    requests.add(Heartbeat(3, 10.0, Autopilot.ARDUPILOT, armed=False, winged=False))
    assert requested_ids(requests, 14.0) == set(WANTED_HZ)


def test_a_second_heartbeat_does_not_begin_the_window_anew():
    requests = StreamRequests()
    for second in range(4):
        requests.add(Heartbeat(3, float(second), Autopilot.ARDUPILOT, armed=False, winged=False))
        assert requested_ids(requests, float(second)) == set()
    assert requested_ids(requests, 4.0) == set(WANTED_HZ)
