"""Frames recorded in flight and sent again, and forged ones, on a link without keys. With keys: test_signed_links.py."""

from __future__ import annotations

import math
import signal
import socket

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from vehicles import LAT, LON, M_PER_DEG_LAT, M_PER_DEG_LON, fly, square_fleet

pytestmark = pytest.mark.integration


def test_without_keys_frames_sent_again_or_forged_from_elsewhere_move_nothing_and_are_told(start_service, free_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}")
    with square_fleet(free_port) as fleet, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as attacker:
        fly(fleet, 60.0, until=lambda: all(v.of("HEARTBEAT") for v in fleet))
        # What vehicle 1 said a kilometre ago, its ranges and those of the denied vehicle, each as it went over the air.
        stale, here = fleet[0], fleet[0].enu_m
        stale.enu_m = (here[0], here[1] + 1000.0, here[2])
        recorded = [frame for step in range(10) for frame in stale.telemetry(step, 3)]
        recorded += [fleet[3].range_to(other) for other in fleet[:3]]
        stale.enu_m = here
        forger = mavlink.MAVLink(None, srcSystem=4, srcComponent=1)
        healthy = mavlink.MAVLink_gps_raw_int_message(10**9, 6, 470_500_000, 80_500_000, 600_000, 80, 80, 0, 0, 18, h_acc=300)

        def attack():
            for frame in [*recorded, healthy.pack(forger)]:
                attacker.sendto(frame, fleet[0].service)
            return sum(m.fix_type == 3 for m in fleet[3].of("GPS_INPUT")) >= 20

        fly(fleet, 30.0, failed=[4], until=attack)
        fixes = [m for m in fleet[3].of("GPS_INPUT") if m.fix_type == 3]
        assert len(fixes) >= 20
        for fix in fixes:
            # 4 sigma of what the vehicles' own positions and ranges give.
            east, north = (fix.lon / 1e7 - LON) * M_PER_DEG_LON, (fix.lat / 1e7 - LAT) * M_PER_DEG_LAT
            assert math.hypot(east - fleet[3].enu_m[0], north - fleet[3].enu_m[1]) < 4.0
        attacker.setblocking(False)
        with pytest.raises(BlockingIOError):
            attacker.recvfrom(4096)
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert service.returncode == 0
    warnings = [line for line in log.splitlines() if "uses its system id" in line]
    assert {sysid for sysid in (1, 4) if any(f"vehicle {sysid}" in line for line in warnings)} == {1, 4}
