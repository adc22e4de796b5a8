"""What a vehicle is requested to send, and when."""

import pytest

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import RouteReport
from gcs_coloc.core.messages.inbound import Autopilot, Heartbeat
from gcs_coloc.core.messages.outbound import Stream, StreamRequest
from gcs_coloc.core.telemetry.stream_requests import HeardStreams, StreamRequests, wanted_hz
from tests.engine_flights import StraightLine


def requested(requests: StreamRequests, now_s: float, autopilot: Autopilot = Autopilot.ARDUPILOT, **heard: int) -> set[Stream]:
    counts = {Stream[name]: count for name, count in heard.items()}
    return {request.stream for request in requests.due(now_s, [HeardStreams(3, autopilot, counts)])}


def test_a_vehicle_that_sends_heartbeats_alone_is_requested_to_send_everything():
    """Real ArduCopters do by default: their stream rates are 0."""
    engine, out = Engine(StraightLine()), []
    for second in range(6):
        engine.receive(Heartbeat(3, float(second), Autopilot.ARDUPILOT, armed=False, winged=False))
        engine.receive(RouteReport(3, float(second), None))
        out += engine.poll(second + 0.5)
    requested_streams = {o.stream for o in out if isinstance(o, StreamRequest)}
    assert requested_streams == {*wanted_hz(Autopilot.ARDUPILOT), Stream.RECEIVER_INTEGRITY}


def test_each_autopilot_is_asked_for_the_status_of_its_own_filter():
    """PX4 refuses EKF_STATUS_REPORT and GPS2_RAW, ArduPilot has no ESTIMATOR_STATUS."""
    assert not {Stream.EKF_STATUS, Stream.SECOND_RECEIVER} & wanted_hz(Autopilot.PX4).keys()
    assert Stream.ESTIMATOR_STATUS in wanted_hz(Autopilot.PX4)
    assert {Stream.EKF_STATUS, Stream.SECOND_RECEIVER} <= wanted_hz(Autopilot.ARDUPILOT).keys()
    assert Stream.ESTIMATOR_STATUS not in wanted_hz(Autopilot.ARDUPILOT)


def test_a_plane_alone_is_asked_whether_it_is_on_its_rotors_until_it_tells():
    """ArduPilot's QuadPlanes are planes by their HEARTBEAT and tell it only where they are asked."""
    plane, copter = StreamRequests(), StreamRequests()
    asked = {True: 0, False: 0}
    for t in range(30):
        for requests, winged in ((plane, True), (copter, False)):
            out = requests.due(float(t), [HeardStreams(3, Autopilot.ARDUPILOT, {}, winged)])
            asked[winged] += Stream.VTOL_STATE in {request.stream for request in out}
    assert asked == {True: 3, False: 0}  # after 4, 12 and 28 s
    heard = StreamRequests()
    out = [heard.due(float(t), [HeardStreams(3, Autopilot.ARDUPILOT, {Stream.VTOL_STATE: 2 * t}, True)]) for t in range(30)]
    assert Stream.VTOL_STATE not in {request.stream for each in out for request in each}


def test_what_few_autopilots_know_is_requested_once_and_again_after_a_reboot_and_not_where_it_comes():
    requests = StreamRequests()
    asked_s = [t for t in range(60) if Stream.RECEIVER_INTEGRITY in requested(requests, float(t))]
    requests.forget(3)
    asked_s += [t for t in range(60, 120) if Stream.RECEIVER_INTEGRITY in requested(requests, float(t))]
    assert asked_s == [4, 64]
    heard = StreamRequests()
    assert not any(Stream.RECEIVER_INTEGRITY in requested(heard, float(t), RECEIVER_INTEGRITY=t) for t in range(60))


def test_what_comes_often_enough_is_not_requested():
    requests = StreamRequests()
    requested(requests, 0.0)
    assert Stream.POSITION not in requested(requests, 4.0, POSITION=20)


@pytest.mark.parametrize("counts", [{}, {"POSITION": 19}])
def test_what_comes_at_less_than_half_of_the_wanted_rate_is_requested(counts):
    requests = StreamRequests()
    requested(requests, 0.0)
    assert Stream.POSITION in requested(requests, 4.0, **counts)


def test_requests_that_are_not_heeded_are_repeated_ever_less_often_and_at_once_after_a_reboot():
    requests = StreamRequests()
    times_s = [t for t in range(60) if requested(requests, float(t))]
    assert times_s == [4, 12, 28]
    requests.forget(3)
    times_s = [t for t in range(60, 80) if requested(requests, float(t))]
    assert times_s == [64, 72]
