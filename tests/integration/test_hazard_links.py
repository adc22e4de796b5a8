"""Links that die and return, autopilots that reboot in flight: the fakes on real sockets against the service as a process.

Undisturbed, an aided autopilot believes itself within 5.1 m of where it is (the worst of seeds 1 to 8 of the same flight in
process); `OFF_M` allows for twice that and a little, while a peer is silent. Time limits are for a loaded machine.
"""

from __future__ import annotations

import signal

import pytest
from fakes_on_air import on_air

from sitl_fakes.faults import GpsLost, LinkDropout, Reboot

pytestmark = pytest.mark.integration

DENIED, PEER = 4, 1
LIMIT_S = 60.0
OFF_M = 12.0


def heard_from(air) -> set[int]:
    """Vehicles that the service has talked to."""
    return set(air.spoken_to_at_s)


def holds(air, for_s: float) -> None:
    """Nothing that the denied vehicle believes is far off for a time, and it goes on flying on what it is sent."""
    ends_s = air.now_s + for_s
    air.fly(LIMIT_S, lambda: air.now_s >= ends_s or air.belief_error_m(DENIED) > OFF_M)
    assert air.belief_error_m(DENIED) <= OFF_M
    assert air.source(DENIED) == "gps2 injected"


def test_links_that_die_and_autopilots_that_reboot_are_got_over(start_service, free_port):
    service = start_service("--udp", f"127.0.0.1:{free_port}")
    with on_air(free_port) as air:
        assert air.fly(LIMIT_S, lambda: len(heard_from(air)) == 4)
        air.fleet.inject(GpsLost(vehicle=DENIED, at_s=air.now_s))
        assert air.fly(LIMIT_S, lambda: air.source(DENIED) == "gps2 injected")

        returns_s = air.now_s + 7.0
        air.fleet.inject(LinkDropout(vehicle=DENIED, at_s=air.now_s, until_s=returns_s))
        # The fix lingers for four seconds and is then gone, rather than going on with what it was last told.
        assert air.fly(LIMIT_S, lambda: air.source(DENIED) == "dead_reckoning")
        assert air.now_s < returns_s
        assert air.fly(LIMIT_S, lambda: air.source(DENIED) == "gps2 injected")
        assert air.now_s > returns_s
        assert air.fly(LIMIT_S, lambda: air.belief_error_m(DENIED) < OFF_M)

        # Two peers are left: the ranges to them and the altitude go on, and nothing is made up of the silent one.
        air.fleet.inject(LinkDropout(vehicle=PEER, at_s=air.now_s, until_s=air.now_s + 4.0))
        holds(air, 6.0)

        air.fleet.inject(Reboot(vehicle=PEER, at_s=air.now_s))
        holds(air, 7.0)

        air.fleet.inject(Reboot(vehicle=DENIED, at_s=air.now_s))
        # It wakes without GPS and without any memory of where it was: the first position it has is the one it is sent.
        assert air.fly(LIMIT_S, lambda: air.source(DENIED) == "none")
        assert air.fly(LIMIT_S, lambda: air.source(DENIED) == "gps2 injected")
        holds(air, 2.0)
    service.send_signal(signal.SIGINT)
    _, log = service.communicate(timeout=60)
    assert service.returncode == 0
    assert "Traceback" not in log
    told = [line for line in log.splitlines() if "its clock jumped: taken as a reboot" in line]
    assert {sysid for sysid in (PEER, DENIED) if any(f"vehicle {sysid}" in line for line in told)} == {PEER, DENIED}
