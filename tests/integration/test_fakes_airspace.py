"""Aircraft of one scenario flown by several processes, which tell each other over real multicast where they are."""

import asyncio
import math
import secrets
import socket
import struct
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest

from sitl_fakes.flight import SharedState
from sitl_fakes.scenario import SCENARIOS, load_scenario
from sitl_fakes.shell import Airspace

pytestmark = pytest.mark.integration

LOOPBACK = ("127.0.0.1", 9)
PEER_RANGE = (181600).to_bytes(3, "little")
SCENARIO = SCENARIOS / "paper.toml"
HERE = SharedState(4, 1000.0, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))


@pytest.fixture
def group(free_port):
    """A group of its own for each run, so that two runs on one machine do not see each other."""
    return f"239.255.{secrets.randbelow(254) + 1}.{secrets.randbelow(254) + 1}", free_port


async def exchange(group, said, ours=(1,)):
    """What a process that flies `ours` hears when another says something, the last thing said being aircraft 99's place."""
    heard: list[SharedState] = []
    done = asyncio.Event()

    def hear(seen):
        done.set() if seen.sysid == 99 else heard.append(seen)

    listener = Airspace(group, LOOPBACK, "paper", ours, hear)
    speaker = Airspace(group, LOOPBACK, "paper", (99,), lambda seen: None)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as raw:
        raw.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK[0]))
        for payload in said:
            if isinstance(payload, SharedState):
                speaker.send([payload])
            else:
                raw.sendto(payload, group)
    speaker.send([replace(HERE, sysid=99)])
    await asyncio.wait_for(done.wait(), 30)
    listener.close()
    speaker.close()
    return heard


def test_an_aircraft_is_seen_where_its_process_says(group):
    assert asyncio.run(exchange(group, [HERE])) == [HERE]


def test_what_is_no_aircraft_of_this_scenario_or_is_ours_is_not_seen_but_told_once(group, caplog):
    garbage = [b"", b"hello", b"[]", b'{"process":"x","scenario":"paper","sysid":1}', b'{"process":1,"scenario":2}']
    place = b'"sysid":7,"at_s":1,"position_m":[%s,0,0],"velocity_mps":[0,0,0]}'
    not_a_number = b'{"process":"x","scenario":"paper",' + place % b"NaN"
    other_scenario = b'{"process":"x","scenario":"uwb",' + place % b"1"
    heard = asyncio.run(exchange(group, [*garbage, not_a_number, other_scenario, other_scenario, HERE], ours=(4,)))
    assert heard == []
    # Both processes hear the first two; the third is about the listener's own aircraft.
    assert Counter(record.getMessage() for record in caplog.records) == {
        "127.0.0.1 speaks in the airspace, but not of simulated aircraft": 2,
        "127.0.0.1 flies another scenario, 'uwb', in the same airspace: it is not seen": 2,
        "vehicle 4 is flown by 127.0.0.1 as well": 1,
    }


def test_an_aircraft_ranges_to_those_that_another_process_flies(group):
    scenario = load_scenario(SCENARIO)
    start_m = {v.sysid: v.waypoints[0] for v in scenario.vehicle}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(60)
        target = f"127.0.0.1:{station.getsockname()[1]}"
        command = [sys.executable, "-m", "sitl_fakes", SCENARIO, "--target", target, "--airspace", "{}:{}".format(*group)]
        flown = [["--vehicle", "4"], ["--vehicle", "1", "--vehicle", "2", "--vehicle", "3"]]
        processes = [subprocess.Popen([*command, *which], stderr=subprocess.DEVNULL) for which in flown]
        try:
            first_m: dict[int, float] = {}
            while set(first_m) != {1, 2, 3}:
                payload = station.recv(2048)
                if payload[7:10] == PEER_RANGE:
                    _, range_m, _, _, peer = struct.unpack_from("<QffHB", payload, 10)
                    first_m.setdefault(peer, range_m)
        finally:
            for process in processes:
                process.terminate()
            assert [process.wait(30) for process in processes] == [0, 0]
    for peer, range_m in first_m.items():
        # Ranges have 20 m of noise, and the processes start some time apart at up to 100 m/s towards each other: a band that
        # no other pair of these aircraft would meet by chance.
        assert abs(range_m - math.dist(start_m[4], start_m[peer])) < 1000.0, peer
