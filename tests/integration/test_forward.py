"""gcs-coloc between vehicles and ground tools: real sockets, the service as a process, pymavlink at both other ends."""

from __future__ import annotations

import re
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import link_peers
import pytest
from command_line import gcs_coloc
from link_peers import PATIENCE_S
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from signed_frames import OTHER_KEY, Signer, of_unknown_id
from test_record import journal_of, live_vehicles, only
from vehicles import fly, square_fleet

from bench import free_ports

pytestmark = pytest.mark.integration

ROOT = Path(__file__).resolve().parents[2]
GPS_INPUT_4 = mavlink.MAVLink_gps_input_message(0, 1, 0, 0, 0, 3, 470_000_000, 80_000_000, 500, 1, 1, 0, 0, 0, 1, 1, 1, 10)


class Tool:
    """A ground tool on a UDP socket of its own, which keeps every datagram and answers where the first came from."""

    def __init__(self, sysid=255, compid=190, port=0):
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind(("127.0.0.1", port))
        self.port = self.sock.getsockname()[1]
        self.mav = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self.datagrams: list[bytes] = []
        self.service = None

    def close(self):
        self.sock.close()

    def listen(self, patience_s=0.0):
        while select.select([self.sock], [], [], patience_s)[0]:
            data, self.service = self.sock.recvfrom(65535)
            self.datagrams.append(data)

    def say(self, message):
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) & 0xFF
        self.sock.sendto(data, self.service)

    def of(self, kind):
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        return [m for d in self.datagrams for m in parser.parse_buffer(d) or [] if m.get_type() == kind]


@pytest.fixture
def tool():
    with closing(Tool()) as it:
        yield it


def aided(vehicle):
    return len(vehicle.of("GPS_INPUT")) >= 15


def test_every_frame_of_a_vehicle_is_handed_on_byte_for_byte_and_without_alarms_nothing_of_ours(
    start_service, free_port, tool, tmp_path
):
    config = tmp_path / "coloc.toml"
    config.write_text(f'links = ["127.0.0.1:{free_port}"]\nout = ["udp:127.0.0.1:{tool.port}"]\n[forward]\nalarms = false\n')
    start_service("--config", str(config))
    sent = []
    signer = Signer(2, compid=154, key=OTHER_KEY)
    with square_fleet(free_port) as fleet:
        for vehicle in fleet:
            send = vehicle.send
            vehicle.send = lambda *data, send=send: (sent.extend(data), send(*data))

        def extras():
            tool.listen()
            # Signed with a key that we do not have, of a message in no dialect of ours, and two frames in one datagram.
            fleet[1].send(
                signer.pack(), of_unknown_id(signer.pack(), OTHER_KEY), signer.pack() + of_unknown_id(signer.pack(), None)
            )
            return aided(fleet[3])

        fly(fleet, 60.0, failed=[4], until=extras)
        assert aided(fleet[3])
        deadline = time.monotonic() + PATIENCE_S
        while set(sent) != set(tool.datagrams) and time.monotonic() < deadline:
            tool.listen(0.5)
    assert set(tool.datagrams) == set(sent)
    assert tool.datagrams[0] == sent[0]


def test_our_gps_input_is_shown_to_the_ground_tools_where_that_is_set(start_service, free_port, tool, tmp_path):
    config = tmp_path / "coloc.toml"
    config.write_text(f'links = ["127.0.0.1:{free_port}"]\nout = ["127.0.0.1:{tool.port}"]\n[forward]\necho_gps_input = true\n')
    start_service("--config", str(config))
    with square_fleet(free_port) as fleet:
        fly(fleet, 60.0, failed=[4], until=lambda: tool.listen() or len(tool.of("GPS_INPUT")) >= 10)
    assert len(tool.of("GPS_INPUT")) >= 10
    assert {m.get_srcSystem() for m in tool.of("GPS_INPUT")} == {254}


def test_ground_tools_are_told_of_a_lost_gps_by_a_component_of_its_vehicle_and_vehicles_are_not(start_service, free_port, tool):
    start_service("--udp", f"127.0.0.1:{free_port}", "--out", f"127.0.0.1:{tool.port}", "--no-web")
    with square_fleet(free_port) as fleet:
        began_s = time.monotonic()

        def lost():
            tool.listen()
            return any("GPS lost, located within" in text.text for text in tool.of("STATUSTEXT"))

        fly(fleet, 5.0)  # where it was with its GPS is what its position starts from
        fly(fleet, 60.0, failed=[4], until=lost)
        assert lost()
        lasted_s = time.monotonic() - began_s
        assert not [text for vehicle in fleet for text in vehicle.of("STATUSTEXT")]
    texts = [text for text in tool.of("STATUSTEXT") if "late" not in text.text]  # a busy machine tells each vehicle's system
    assert {(text.get_srcSystem(), text.get_srcComponent()) for text in texts} == {(4, 191)}
    assert re.fullmatch(r"UAV4: GPS lost, located within \d+ m(, not aided)?", texts[-1].text)
    assert all(text.severity in (mavlink.MAV_SEVERITY_CRITICAL, mavlink.MAV_SEVERITY_WARNING) for text in texts)
    ours = [beat for beat in tool.of("HEARTBEAT") if beat.get_srcSystem() == 254]
    assert 1 <= len(ours) <= lasted_s + 2
    kinds = {(beat.get_srcComponent(), beat.type, beat.autopilot) for beat in ours}
    assert kinds == {(191, mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID)}


def test_a_ground_tool_never_takes_us_for_its_vehicle(start_service, free_port):
    port = free_ports.free_port()
    start_service("--udp", f"127.0.0.1:{free_port}", "--out", f"127.0.0.1:{port}", "--no-web")
    with closing(mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)) as ground:
        alone = ground.recv_match(blocking=True, timeout=2.5)
        assert alone is None  # Mission Planner connects to whom it hears, where that is one alone
        with square_fleet(free_port) as fleet:
            chosen, ours = set(), 0

            def hear():
                nonlocal ours
                while (message := ground.recv_match()) is not None:
                    ours += message.get_srcSystem() == 254
                    chosen.add(ground.target_system)
                return ours >= 3

            fly(fleet, 60.0, until=hear)
        assert ours >= 3
        assert chosen - {0} <= {1, 2, 3, 4}


def test_what_a_ground_tool_says_goes_to_whom_it_is_meant_for(start_service, free_port, tool):
    service = start_service("--udp", f"127.0.0.1:{free_port}", "--out", f"127.0.0.1:{tool.port}")
    with square_fleet(free_port) as fleet, closing(Tool()) as stranger:
        fly(fleet, 60.0, until=lambda: tool.listen() or len(tool.of("HEARTBEAT")) >= 8)
        assert all(v.of("HEARTBEAT") for v in fleet)
        for vehicle in fleet:
            vehicle.received.clear()
        # A vehicle's system id in a ground tool's frame, and somebody who found the port that we send from.
        tool.mav.srcSystem = 3
        tool.say(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 21196, 0, 0, 0, 0, 0))
        tool.mav.srcSystem = 255
        stranger.service = tool.service
        stranger.say(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 2, 21196, 0, 0, 0, 0, 0))
        tool.say(mavlink.MAVLink_command_long_message(77, 1, 400, 0, 3, 0, 0, 0, 0, 0, 0))
        tool.say(mavlink.MAVLink_command_long_message(2, 1, 400, 0, 4, 0, 0, 0, 0, 0, 0))
        tool.say(mavlink.MAVLink_manual_control_message(3, 500, 0, 0, 0, 0))
        tool.say(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3))

        def heard_the_last():
            return all(any(m.get_srcSystem() == 255 for m in v.of("HEARTBEAT")) for v in fleet)

        fly(fleet, 60.0, until=heard_the_last)
        assert heard_the_last()
        assert [[m.param1 for m in v.of("COMMAND_LONG") if m.command == 400] for v in fleet] == [[], [4], [], []]
        assert [len(v.of("MANUAL_CONTROL")) for v in fleet] == [0, 0, 1, 0]
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    for reason in ("ground_tool_uses_vehicle_id 1", "ground_tool_unknown_sender 1", "ground_tool_unknown_target 1"):
        assert reason in log
    assert "vehicle 255" not in log
    assert "address_conflict" not in log


def test_never_do_we_and_a_ground_tool_feed_one_vehicle_and_the_operator_is_told(start_service, free_port, tool):
    service = start_service("--udp", f"127.0.0.1:{free_port}", "--out", f"127.0.0.1:{tool.port}")
    with square_fleet(free_port) as fleet:
        fly(fleet, 60.0, failed=[4], until=lambda: tool.listen() or aided(fleet[3]))
        assert aided(fleet[3])

        def others():
            return [sum(m.get_srcSystem() == 255 for m in v.of("GPS_INPUT")) for v in fleet]

        fly(fleet, 60.0, failed=[4], until=lambda: tool.say(GPS_INPUT_4) or min(others()[:3]) >= 15)
        assert min(others()[:3]) >= 15
        assert others()[3] == 0
        # Vehicle 3 needs aid while the tool feeds it: ours stands down.
        fly(fleet, 6.0, failed=[3, 4], until=lambda: tool.say(GPS_INPUT_4))
        assert {m.get_srcSystem() for m in fleet[2].of("GPS_INPUT")} == {255}
        assert others()[3] == 0
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert "vehicle 4: a ground tool on udpout" in log
    assert "ground_tool_aiding" in log
    assert "vehicle 3: needs aid and cannot be aided: system 255 sends it GPS_INPUT" in log


def test_a_flight_with_a_ground_tool_replays_to_the_last_bit_and_its_commands_are_in_the_tlog(
    start_service, free_port, tool, tmp_path
):
    service = start_service(
        "--udp", f"127.0.0.1:{free_port}", "--out", f"127.0.0.1:{tool.port}", "--record", str(tmp_path), "--no-web"
    )
    with square_fleet(free_port) as fleet:
        said = 0

        def meddle():
            nonlocal said
            tool.listen()
            if tool.service is not None:
                said += 1
                # Were it the engine's, it would be a range from a vehicle 255.
                tool.say(mavlink.MAVLink_named_value_float_message(1000, b"RNG4", 123.0))
                tool.say(mavlink.MAVLink_command_long_message(4, 1, 400, 0, 4, 0, 0, 0, 0, 0, 0))
                tool.say(GPS_INPUT_4)  # of which the engine is told, where it reaches a vehicle
            return False

        def commands():
            return sum(m.command == 400 for m in fleet[3].of("COMMAND_LONG"))

        fly(fleet, 6.0, failed=[4], until=meddle)
        fly(fleet, link_peers.PATIENCE_S, failed=[4], until=lambda: commands() >= said)
    service.send_signal(signal.SIGTERM)
    service.communicate(timeout=60)
    live, (replayed, _) = live_vehicles(only(tmp_path, "mcap")), journal_of(only(tmp_path, "tlog"))
    assert live[: len(replayed)] == replayed
    assert len(replayed) > 0.9 * len(live) > 4 * 2.5 * 3
    with closing(mavutil.mavlink_connection(str(only(tmp_path, "tlog")))) as log:
        recorded = []
        while (message := log.recv_match(type=["COMMAND_LONG"])) is not None:
            recorded.append((message.get_srcSystem(), message.command))
    assert recorded.count((255, 400)) == commands() == said > 10


def test_a_ground_tool_that_does_not_read_costs_the_flight_nothing(start_service, free_port):
    port = free_ports.free_port(socket.SOCK_STREAM)
    with socket.create_server(("127.0.0.1", port)) as listener, square_fleet(free_port) as fleet:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        service = start_service("--udp", f"127.0.0.1:{free_port}", "--out", f"tcp:127.0.0.1:{port}")
        listener.settimeout(PATIENCE_S)
        deaf, _ = listener.accept()
        with deaf:
            # Far beyond what the system's buffers and ours hold.
            def flood():
                for number in range(20):
                    blob = mavlink.MAVLink_data96_message(number, 96, [1 + n for n in range(96)])
                    fleet[0].send(*(fleet[0].pack(blob) for _ in range(8)))
                return False

            fly(fleet, 6.0, failed=[4], until=flood)
            assert aided(fleet[3])
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert service.returncode == 0
    assert "output_skipped" in log


@pytest.mark.parametrize(("ours", "theirs"), [("udp", "udpin"), ("udpin", "udpout"), ("tcpin", "tcp")])
def test_mavutil_reads_a_parameter_of_one_vehicle_of_a_fleet_through_us(start_service, free_port, ours, theirs):
    port = free_ports.free_port(socket.SOCK_STREAM if ours == "tcpin" else socket.SOCK_DGRAM)
    start_service("--udp", f"127.0.0.1:{free_port}", "--out", f"{ours}:127.0.0.1:{port}")
    with closing(mavutil.mavlink_connection(f"{theirs}:127.0.0.1:{port}", source_system=255, dialect="ardupilotmega")) as ground:
        command = [sys.executable, "-m", "sitl_fakes", "paper", "--target", f"127.0.0.1:{free_port}"]
        fakes = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
        try:
            found = {}
            deadline = time.monotonic() + 60.0
            while len(found) < 2 and time.monotonic() < deadline:
                ground.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4)
                for sysid in (1, 4):
                    ground.mav.param_request_read_send(sysid, 1, b"EK3_GPS_CHECK", -1)
                answer = ground.recv_match(type="PARAM_VALUE", blocking=True, timeout=1.0)
                if answer is not None:
                    found[answer.get_srcSystem()] = (answer.param_id, answer.param_value)
            assert found == {1: ("EK3_GPS_CHECK", 23.0), 4: ("EK3_GPS_CHECK", 19.0)}
        finally:
            fakes.kill()
            fakes.wait()


def test_a_ground_tool_at_our_own_port_is_a_mistake_in_one_line(free_port):
    done = gcs_coloc("--udp", f"127.0.0.1:{free_port}", "--out", f"127.0.0.1:{free_port}")
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.strip().splitlines()) == 1
    assert "leads back" in done.stderr
