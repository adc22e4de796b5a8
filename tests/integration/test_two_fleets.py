"""Two fleets in one process whose vehicles have the same system ids, on real UDP sockets."""

from __future__ import annotations

import math
import signal
from concurrent.futures import ThreadPoolExecutor

import pytest
from command_line import gcs_coloc
from vehicles import LAT, LON, M_PER_DEG_LAT, M_PER_DEG_LON, fly, square_fleet

from bench.free_ports import free_ports

pytestmark = pytest.mark.integration

_FAR_M = 30_000.0


@pytest.fixture
def ports() -> list[int]:
    return free_ports(2)


@pytest.fixture
def two_fleets(tmp_path, ports):
    path = tmp_path / "fleets.toml"
    tables = [
        f'[[fleet]]\nname = "{name}"\nlinks = ["udpin:127.0.0.1:{port}"]\n'
        for name, port in zip(("north", "south"), ports, strict=True)
    ]
    path.write_text(
        f'[record]\ndirectory = "{tmp_path / "flights"}"\n' + "\n".join(tables) + "\n[fleet.aiding]\nalert_limit_m = 60\n"
    )
    return path


def fixes(vehicle) -> list:
    return [m for m in vehicle.of("GPS_INPUT") if m.fix_type == 3]


def miss_m(fix, enu_m) -> float:
    return math.hypot((fix.lon / 1e7 - LON) * M_PER_DEG_LON - enu_m[0], (fix.lat / 1e7 - LAT) * M_PER_DEG_LAT - enu_m[1])


def test_fleets_that_share_system_ids_are_located_each_in_its_own_place(start_service, two_fleets, ports, tmp_path):
    service = start_service("--config", str(two_fleets))
    with square_fleet(ports[0]) as north, square_fleet(ports[1]) as south, ThreadPoolExecutor(2) as pilots:
        for vehicle in south:
            vehicle.enu_m = (vehicle.enu_m[0] + _FAR_M, *vehicle.enu_m[1:])
        list(pilots.map(lambda fleet: fly(fleet, 3.0), (north, south)))
        # First in one fleet alone: the other's vehicle of the same id is healthy and must get nothing.
        legs = (
            (north, {"failed": [4], "until": lambda: len(fixes(north[3])) >= 10}),
            (south, {"until": lambda: len(fixes(north[3])) >= 10}),
        )
        list(pilots.map(lambda leg: fly(leg[0], 15.0, **leg[1]), legs))
        assert len(fixes(north[3])) >= 10
        assert not any(v.of("GPS_INPUT") for v in (*north[:3], *south))

        done = lambda: len(fixes(south[3])) >= 10  # noqa: E731
        list(pilots.map(lambda fleet: fly(fleet, 60.0, failed=[4], until=done), (north, south)))
        assert len(fixes(south[3])) >= 10
        # 4 sigma of a filtered position from GPS of 0.8 m and ranges of 0.5 m that are exact here, as for a single fleet.
        for fleet in (north, south):
            assert all(miss_m(fix, fleet[3].enu_m) < 4.0 for fix in fixes(fleet[3]))
        assert not any(v.of("GPS_INPUT") for v in (*north[:3], *south[:3]))

        service.send_signal(signal.SIGTERM)
        over = lambda: service.poll() is not None  # noqa: E731
        list(pilots.map(lambda fleet: fly(fleet, 60.0, failed=[4], until=over), (north, south)))
        assert service.wait(60) == 0
        assert [fleet[3].of("GPS_INPUT")[-1].fix_type for fleet in (north, south)] == [1, 1]
    assert "north: vehicle 4: GPS" in service.stderr.read()
    assert sorted(path.name for path in (tmp_path / "flights").iterdir()) == ["north", "south"]
    assert all(list((tmp_path / "flights" / name).glob("*.tlog")) for name in ("north", "south"))


def test_check_config_goes_through_every_fleet(two_fleets):
    done = gcs_coloc("check-config", two_fleets)
    assert done.returncode == 0, done.stderr
    assert "fleet north: 1 link(s), estimator fleet; fleet south: 1 link(s), estimator fleet" in done.stdout
    two_fleets.write_text(two_fleets.read_text() + '[fleet.estimator]\nname = "absent"\n')
    done = gcs_coloc("check-config", two_fleets)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "absent" in done.stderr
