"""Signed links from end to end: real sockets, the service as a process, and pymavlink signing and verifying at the other end."""

from __future__ import annotations

import random
import signal
import socket
import time

import pytest
from command_line import gcs_coloc
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from signed_frames import OTHER_KEY, Signer, heartbeat, of_unknown_id
from vehicles import fly, square_fleet

pytestmark = pytest.mark.integration

KEY = bytes(range(200, 232))


def now_ticks() -> int:
    return int((time.time() - 1_420_070_400) * 1e5)


@pytest.fixture
def start_signed(start_service, tmp_path, free_port):
    """Starts the service with its one link signed in a mode."""

    def start(mode):
        key_file = tmp_path / "signing.key"
        key_file.write_text(KEY.hex())
        key_file.chmod(0o600)
        config = tmp_path / "coloc.toml"
        config.write_text(f'links = ["127.0.0.1:{free_port}"]\n[signing]\nkey_file = "{key_file}"\nmode = "{mode}"\n')
        return start_service("--config", str(config))

    return start


def signing(vehicle):
    """Make a hovering vehicle sign what it sends and take nothing that is not signed."""
    state = vehicle.mav.signing
    state.secret_key, state.sign_outgoing, state.timestamp = KEY, True, now_ticks()
    vehicle.parser.signing.secret_key, vehicle.parser.signing.timestamp = KEY, now_ticks()


def located(vehicle):
    return sum(m.fix_type == 3 for m in vehicle.of("GPS_INPUT")) >= 10


def test_a_signed_fleet_is_served_while_forged_unsigned_and_recorded_frames_are_refused(start_signed, free_port):
    service = start_signed("require")
    rng = random.Random(11)
    with square_fleet(free_port) as fleet, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker:
        for vehicle in fleet:
            signing(vehicle)
        recorded = [frame for step in range(20) for frame in fleet[0].telemetry(step, 3)]
        fleet[0].send(*recorded)

        def attack():
            # Vehicle 1 a kilometre away, a vehicle that does not exist, and vehicle 4 at the attacker's address.
            position = mavlink.MAVLink_global_position_int_message(
                rng.randrange(10**6), 470_100_000, 80_100_000, 600_000, 0, 0, 0, 0, 0
            )
            for key in (None, OTHER_KEY):
                for sysid in (1, 4, 77):
                    forger = Signer(sysid, key=key, ticks=now_ticks() + 10**9)
                    forger.mav.seq = rng.randrange(256)
                    for frame in (forger.pack(position), forger.pack(), of_unknown_id(forger.pack(), key)):
                        attacker.sendto(frame, fleet[0].service)
            attacker.sendto(rng.choice(recorded[:-1]), fleet[0].service)
            return located(fleet[3])

        fly(fleet, 3.0, until=lambda: attack() and False)
        fly(fleet, 15.0, failed=[4], until=attack)
        assert located(fleet[3])
        assert all(m.get_signed() for v in fleet for _, m in v.received)
        assert not any(v.of("GPS_INPUT") for v in fleet[:3])
        attacker.setblocking(False)
        with pytest.raises(BlockingIOError):
            attacker.recvfrom(4096)
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert service.returncode == 0
    for reason in ("unsigned", "signature_wrong", "signature_replayed"):
        assert f"{reason} " in log
    assert "another sender" not in log  # as nothing of the attacker's came so far
    assert "vehicle 77" not in log


def follow(vehicle):
    """Make a vehicle sign for the latest time that it has verified, as autopilots do."""
    vehicle.parser.signing = vehicle.mav.signing


@pytest.mark.parametrize("first_ahead_s", [0, 86_400])
def test_a_vehicle_that_signs_behind_our_time_is_told_it_and_then_heard(start_signed, free_port, first_ahead_s):
    # As after a start with the host's clock a day ahead, or with a vehicle's clock so: nobody's time of signatures runs back.
    service = start_signed("require")
    with square_fleet(free_port) as fleet:
        for vehicle in fleet[:2]:
            signing(vehicle)
            follow(vehicle)
        fleet[0].mav.signing.timestamp += first_ahead_s * 100_000
        fleet[1].mav.signing.timestamp -= 86_400 * 100_000 if first_ahead_s == 0 else 0

        def heard(vehicle):
            return lambda: bool(vehicle.of("TIMESYNC"))  # only a vehicle is asked for its time

        fly(fleet[:1], 30.0, until=heard(fleet[0]))
        assert heard(fleet[0])()
        fly(fleet[:2], 30.0, until=heard(fleet[1]))
        assert heard(fleet[1])()
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert "signature_old " in log
    assert ("24 hours ahead of this computer's clock" in log) == (first_ahead_s > 0)


def test_a_recording_that_is_too_old_gets_a_greeting_and_is_heard_no_more_than_before(start_signed, free_port):
    service = start_signed("require")
    with square_fleet(free_port) as fleet:
        vehicle = fleet[0]
        signing(vehicle)
        vehicle.mav.signing.timestamp -= 86_400 * 100_000
        recorded = [frame for step in range(20) for frame in vehicle.telemetry(step, 3)]

        vehicle.sock.settimeout(30.0)
        for _ in range(3):
            vehicle.send(*recorded)
            vehicle.received += [(0.0, m) for m in vehicle.parser.parse_buffer(vehicle.sock.recvfrom(4096)[0])]
        assert {m.get_type() for _, m in vehicle.received} == {"HEARTBEAT"}
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert "signature_old " in log
    assert "vehicle 1" not in log


def test_on_an_unsigned_link_a_pretender_is_refused_and_named(start_service, free_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}")
    with square_fleet(free_port) as fleet, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pretender:
        pretender.bind(("127.0.0.1", 0))
        fly(fleet[:2], 1.0)

        def pretend():
            pretender.sendto(Signer(2, key=None).pack(), fleet[0].service)
            return False

        fly(fleet[:2], 2.5, until=pretend)
        address = pretender.getsockname()[1]
        pinned = fleet[1].sock.getsockname()[1]
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    (line,) = [line for line in log.splitlines() if "uses its system id" in line]
    assert "vehicle 2" in line
    assert f"127.0.0.1:{address}" in line
    assert f"127.0.0.1:{pinned}" in line


@pytest.mark.parametrize("mode", ["require", "accept"])
def test_mavutil_with_our_key_is_heard_and_verifies_what_we_send(start_signed, free_port, monkeypatch, mode):
    start_signed(mode)
    monkeypatch.setenv("MAVLINK20", "1")  # else it begins with MAVLink 1 and forgets the key when it changes over
    peer = mavutil.mavlink_connection(f"udpout:127.0.0.1:{free_port}", source_system=9, dialect="ardupilotmega")
    try:
        peer.setup_signing(KEY, sign_outgoing=True)
        for _ in range(50):
            peer.mav.send(heartbeat())
            # What is not signed with the key does not come out of mavutil as a heartbeat.
            answer = peer.recv_match(type="HEARTBEAT", blocking=True, timeout=0.2)
            if answer is not None:
                break
        assert answer is not None
        assert answer.get_signed()
        assert (answer.get_srcSystem(), answer.get_srcComponent()) == (254, 191)
    finally:
        peer.close()


def test_a_key_that_others_can_read_ends_in_one_line_with_the_remedy(tmp_path, free_port):
    key_file, config = tmp_path / "signing.key", tmp_path / "coloc.toml"
    key_file.write_text(KEY.hex())
    key_file.chmod(0o644)
    config.write_text(f'links = ["127.0.0.1:{free_port}"]\n[signing]\nkey_file = "{key_file}"\nmode = "require"\n')
    for arguments in (["--config", str(config)], ["check-config", str(config)]):
        done = gcs_coloc(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert len(done.stderr.strip().splitlines()) == 1
        assert f"chmod 600 {key_file}" in done.stderr
        assert KEY.hex() not in done.stderr
