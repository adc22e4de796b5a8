"""A side-channel record comes back from the tlog as it was, bit by bit; records of others are ignored."""

import json

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.deadlines import Overrun
from gcs_coloc.core.messages.control import (
    AidingOverride,
    ClockReference,
    CommandSource,
    ForeignGpsInput,
    GpsOverride,
    HoldBack,
    OperatorCommand,
    PrimaryOverride,
    RouteBlock,
    RouteReport,
    SwitchedByOther,
    SwitchedReceiver,
)
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.recorder.side_channel import PAYLOAD_TYPE, FlownWith, GroundTool, SideChannelWriter, read_side_channel

AT_S = 1_795_216_162.424732
OWN = (254, 191)


@pytest.mark.parametrize(
    "record",
    [
        ClockReference(AT_S, -1.1920928955078125e-07, True),
        ClockReference(AT_S, None, None),
        OperatorCommand(250, AT_S, GpsOverride.FAILED),
        OperatorCommand(4, AT_S, GpsOverride.AUTO),
        OperatorCommand(4, AT_S, AidingOverride.AUTO),
        OperatorCommand(250, AT_S, AidingOverride.OFF),
        OperatorCommand(250, AT_S, PrimaryOverride.OURS),
        OperatorCommand(250, AT_S, PrimaryOverride.OWN, CommandSource.CONFIGURATION),
        ForeignGpsInput(255, AT_S, 1, 250),
        HoldBack(AT_S, held=True),
        HoldBack(AT_S, held=False),
        SwitchedByOther(AT_S, SwitchedReceiver(250, 2.0, 9), held=True),
        SwitchedByOther(AT_S, SwitchedReceiver(4), held=False),
        RouteReport(4, AT_S, None),
        Overrun(AT_S, AT_S + 1.3000000000000003),
        RouteReport(250, AT_S, RouteBlock.SHARED_ADDRESS, (1, 4)),
        RouteReport(250, AT_S, RouteBlock.NO_HEARTBEAT),
        PeerRange(255, AT_S, 254, 1234.5678901234567, 0.12345678901234568, AT_S - 0.1, TimeBase.SERVICE, 4_294_967_295, 0.1, 255),
        GroundTool(255, 190, AT_S),
        FlownWith("0123456789abcdef", AT_S),
        PeerRange(4, AT_S, 1, 0.1, None, None, TimeBase.UNIX, None, None, 0),
    ],
)
def test_a_record_comes_back_as_it_was(record):
    writer = SideChannelWriter(*OWN)
    for repeated in (False, True):
        try:
            frame = writer.pack(record, repeated=repeated)
        except ValueError:
            assert repeated
            assert isinstance(record, PeerRange)  # a range is never repeated at the beginning of a segment
            continue
        read = read_side_channel(frame, AT_S, OWN)
        assert (read.record, read.repeated) == (record, repeated)


def test_of_many_vehicles_at_one_address_as_many_are_recorded_as_fit():
    record = RouteReport(250, AT_S, RouteBlock.SHARED_ADDRESS, tuple(range(100, 250)))
    read = read_side_channel(SideChannelWriter(*OWN).pack(record, repeated=True), AT_S, OWN)
    assert read.record == RouteReport(250, AT_S, RouteBlock.SHARED_ADDRESS, tuple(range(100, 116)))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("vehicles 1, 2 and 4 are heard from one address (a router?),", RouteBlock.SHARED_ADDRESS),
        ("no autopilot heartbeat of vehicle 4 has been heard yet", RouteBlock.NO_HEARTBEAT),
    ],
)
def test_a_reason_of_a_recording_of_version_0_1_is_understood(text, reason):
    data = json.dumps({"route": text, "of": 4}).encode()
    tunnel = mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, len(data), list(data.ljust(128, b"\0")))
    frame = bytes(tunnel.pack(mavlink.MAVLink(None, srcSystem=OWN[0], srcComponent=OWN[1])))
    assert read_side_channel(frame, AT_S, OWN).record == RouteReport(4, AT_S, reason)


@pytest.mark.parametrize(
    ("text", "record", "repeated"),
    [
        ('{"word":"failed","of":4}', OperatorCommand(4, AT_S, GpsOverride.FAILED), False),
        ('{"aid":"off","of":4,"again":1}', OperatorCommand(4, AT_S, AidingOverride.OFF), True),
        ('{"primary":"ours","of":4}', OperatorCommand(4, AT_S, PrimaryOverride.OURS), False),
        ('{"other":[255,1,250]}', ForeignGpsInput(255, AT_S, 1, 250), False),
        ('{"route":null,"of":4}', RouteReport(4, AT_S, None), False),
        ('{"held":1795251578.25}', Overrun(1795251578.25, AT_S), False),
        ('{"ground":[255,190]}', GroundTool(255, 190, AT_S), False),
        ('{"begin":1}', None, False),
    ],
)
def test_a_record_of_version_0_1_is_read(text, record, repeated):
    read = read_side_channel(tunnel(text.encode()), AT_S, OWN)
    assert (read.record, read.repeated) == (record, repeated)


def tunnel(content: bytes) -> bytes:
    message = mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, len(content), list(content.ljust(128, b"\0")))
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=OWN[0], srcComponent=OWN[1])))


def test_the_mark_at_the_beginning_of_a_segment_holds_no_record():
    read = read_side_channel(SideChannelWriter(*OWN).pack(None), AT_S, OWN)
    assert read.record is None


def test_what_others_send_is_no_record():
    assert read_side_channel(SideChannelWriter(4, 1).pack(OperatorCommand(1, AT_S, GpsOverride.HEALTHY)), AT_S, OWN) is None
    ours = mavlink.MAVLink(None, srcSystem=OWN[0], srcComponent=OWN[1])
    for payload_type, content in (
        (PAYLOAD_TYPE, b"{}"),
        (PAYLOAD_TYPE, b"\xff"),
        (PAYLOAD_TYPE, b"[1]"),
        (1, b'{"gps":"failed","sysid":4}'),
    ):
        data = list(content.ljust(128, b"\0"))
        tunnel = mavlink.MAVLink_tunnel_message(0, 0, payload_type, len(content), data)
        assert read_side_channel(tunnel.pack(ours), AT_S, OWN) is None
    heartbeat = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
    assert read_side_channel(heartbeat.pack(ours), AT_S, OWN) is None
    assert read_side_channel(heartbeat.pack(ours, force_mavlink1=True), AT_S, OWN) is None
