"""Ground tools: what is refused of their addresses before anything is opened, and whose frames go where."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.config.sections import SigningConfig
from gcs_coloc.core.errors import UsageError
from gcs_coloc.links.base import check_outs
from gcs_coloc.links.forward import MAX_TOOLS, TOOL_KEPT_S, WARN_EVERY_S, Forwarder
from gcs_coloc.links.routes import RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.framing import read_frame
from tests.signed_frames import KEY, OTHER_KEY, Signer


@pytest.mark.parametrize(
    ("out", "link"),
    [
        ("udp:127.0.0.1:14550", "14550"),
        ("localhost:14550", "127.0.0.1:14550"),
        ("udp:10.0.0.1:14550", "udpin:10.0.0.1:14550"),
        ("udpout:10.0.0.2:14550", "udpout:10.0.0.2:14550"),
        ("udpin:0.0.0.0:14550", "14550"),
        ("tcp:127.0.0.1:5760", "tcpin:5760"),
        ("tcp:10.0.0.9:5760", "tcp:10.0.0.9:5760"),
        ("/dev/ttyUSB0", "serial:/dev/ttyUSB0:115200"),
    ],
)
def test_a_ground_tool_that_would_be_one_of_the_vehicles_links_is_refused(out, link):
    with pytest.raises(UsageError, match="leads back to the vehicles' link"):
        check_outs([out], ["udpin:0.0.0.0:20000", link])


@pytest.mark.parametrize(
    ("out", "link"),
    [
        ("udp:127.0.0.1:14551", "14550"),
        ("udp:192.168.1.20:14550", "14550"),  # QGroundControl on another machine
        ("tcp:127.0.0.1:14550", "14550"),
        ("/dev/ttyUSB1", "/dev/ttyUSB0"),
        ("/dev/ttyUSB1", "14550"),
    ],
)
def test_a_ground_tool_elsewhere_is_taken(out, link):
    check_outs([out], [link])


def test_a_ground_tool_given_twice_is_refused():
    with pytest.raises(UsageError, match="given twice"):
        check_outs(["127.0.0.1:14551", "udpout:127.0.0.1:14551"], ["14550"])


def test_a_ground_tools_link_is_signed_like_the_others_unless_told(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text("ab" * 32)
    key_file.chmod(0o600)
    config = SigningConfig(key_file=str(key_file), mode="require", links={"udp:127.0.0.1:14552": "off"})
    signed = SignedLinks(config, ["14550"], ["udp:127.0.0.1:14551", "127.0.0.1:14552"])
    assert signed.of("udpout:127.0.0.1:14551").required
    assert signed.of("udpout:127.0.0.1:14552") is None


class Radio:
    """A vehicles' link that keeps what is sent."""

    name = "radio"

    def __init__(self):
        self.sent = []

    def send(self, address, payload, *, forwarded=False):
        assert forwarded
        self.sent.append((address, payload))


class Between:
    """A forwarder with one listening ground tool's port, which is not opened, and vehicles 1 and 2 on a radio."""

    def __init__(self, signing=None):
        self.radio, self.now_s, self.forwarded = Radio(), 100.0, []
        self.aided, self.foreign_gps_input = set(), []
        self.routes = RouteTable()
        for sysid in (1, 2):
            self.routes.learn(sysid, 1, self.radio, f"vehicle {sysid}", is_autopilot_heartbeat=True, now_s=self.now_s)
        self.forwarder = Forwarder(
            ["udpin:127.0.0.1:14551"],
            self.routes,
            SignedLinks(signing or SigningConfig(), [], ["udpin:127.0.0.1:14551"]),
            lambda: self.now_s,
            own=(254, 191),
            bytes_per_s=200_000.0,
            is_aided=lambda sysid: sysid in self.aided,
            forwarded=self.forwarded.append,
            foreign_gps_input=lambda raw, sysid: self.foreign_gps_input.append(sysid),
        )
        (self.ground,) = self.forwarder.links

    def say(self, frame, tool="a tool"):
        self.forwarder.from_ground_tool(self.ground, tool, frame, self.now_s)

    @property
    def tools(self):
        return self.forwarder.snapshots()[0].tools


def command(sysid=2, sender=255, key=None):
    return Signer(sender, compid=190, key=key).pack(mavlink.MAVLink_command_long_message(sysid, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))


def test_a_tool_that_has_gone_quiet_is_sent_nothing_more():
    between = Between()
    assert between.tools == 0
    between.say(command())
    between.now_s += TOOL_KEPT_S
    assert between.tools == 1
    between.now_s += 0.1
    assert between.tools == 0


def test_one_port_has_room_for_so_many_tools_and_for_another_when_one_has_gone():
    between = Between()
    for number in range(MAX_TOOLS):
        between.say(command(), tool=f"tool {number}")
    between.say(command(), tool="one too many")
    assert between.tools == MAX_TOOLS
    assert len(between.radio.sent) == MAX_TOOLS
    assert between.forwarder.counts["too_many_ground_tools"] == between.forwarder.snapshots()[0].refused == 1
    between.now_s += TOOL_KEPT_S + 0.1
    between.say(command(), tool="one too many")
    assert len(between.radio.sent) == MAX_TOOLS + 1


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (command(sender=1), "ground_tool_uses_vehicle_id"),
        (command(sender=0), "invalid_value:header.sysid"),
        (Signer(254, compid=191, key=None).pack(), "echo"),
        (command(sysid=77), "ground_tool_unknown_target"),
        (command()[:-1] + b"\xff", "bad_crc"),
    ],
)
def test_what_is_not_handed_on_to_a_vehicle_is_counted(frame, reason):
    between = Between()
    between.say(frame)
    assert between.radio.sent == between.forwarded == []
    assert between.forwarder.counts[reason] == 1
    assert between.forwarder.snapshots()[0].refused == 1


def test_a_command_to_us_is_nobodys_elses():
    between = Between()
    between.say(command(sysid=254))
    assert between.radio.sent == []


def test_a_frame_goes_to_its_vehicle_as_it_came_and_is_given_to_the_recording():
    between = Between()
    between.say(command(sysid=2, key=KEY))
    ((address, frame),) = between.radio.sent
    assert (address, frame) == ("vehicle 2", command(sysid=2, key=KEY))
    assert [raw.frame for raw in between.forwarded] == [frame]


def test_where_signatures_are_required_a_tool_without_the_key_commands_nobody(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text(KEY.hex())
    key_file.chmod(0o600)
    between = Between(SigningConfig(key_file=str(key_file), mode="require"))
    between.say(command())
    between.say(command(key=OTHER_KEY))
    assert between.radio.sent == []
    assert (between.forwarder.counts["unsigned"], between.forwarder.counts["signature_wrong"]) == (1, 1)
    between.say(command(key=KEY))
    assert len(between.radio.sent) == 1


def test_frames_under_a_vehicles_system_id_from_elsewhere_are_not_shown_to_the_tools():
    between = Between()
    between.say(command())
    heard = [read_frame(Signer(sysid, key=None).pack(), 0) for sysid in (1, 9)]
    between.forwarder.from_vehicle(heard, between.radio, "somebody", between.now_s)
    assert between.forwarder.counts["forward_address_conflict"] == 1
    assert between.forwarder.snapshots()[0].frames_sent == 1
    between.forwarder.from_vehicle(heard[:1], between.radio, "vehicle 1", between.now_s)
    assert between.forwarder.snapshots()[0].frames_sent == 2


def test_positions_of_a_ground_tool_are_kept_from_the_vehicle_that_we_aid_and_told_now_and_then():
    between = Between()
    between.aided.add(2)
    tool = Signer(255, key=None)
    between.say(tool.pack(mavlink.MAVLink_gps_input_message(0, 1, 0, 0, 0, 3, 1, 1, 0, 1, 1, 0, 0, 0, 1, 1, 1, 9)))
    for sysid in (1, 2):
        between.say(tool.pack(mavlink.MAVLink_global_position_sensor_message(sysid, 1, 1, 0, 1, 0, 0, 1, 1, 1.0, 1.0, 1.0, 1.0)))
    assert [address for address, _ in between.radio.sent] == ["vehicle 1", "vehicle 1"]
    assert between.foreign_gps_input == [1]
    assert between.forwarder.counts["ground_tool_aiding"] == 2
    ((sysid, text),) = between.forwarder.pending_warnings(between.now_s)
    assert sysid == 2
    assert "GLOBAL_POSITION_SENSOR" in text
    between.say(tool.pack(mavlink.MAVLink_gps_input_message(0, 1, 0, 0, 0, 3, 1, 1, 0, 1, 1, 0, 0, 0, 1, 1, 1, 9)))
    assert between.forwarder.pending_warnings(between.now_s + 1.0) == []
    assert between.forwarder.pending_warnings(between.now_s + WARN_EVERY_S)[0][0] == 2


def test_a_vision_position_of_a_ground_tool_is_kept_from_the_vehicle_that_we_aid():
    between = Between()
    between.aided.add(2)
    between.say(Signer(255, key=None).pack(mavlink.MAVLink_vision_position_estimate_message(1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert [address for address, _ in between.radio.sent] == ["vehicle 1"]
    assert between.forwarder.counts["ground_tool_aiding"] == 1
    assert between.foreign_gps_input == []
