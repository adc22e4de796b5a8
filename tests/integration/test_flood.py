"""A flood on the service's own socket: the vehicle without GPS is located all the same, and the flood is named."""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
import sys

import pytest
from vehicles import LAT, LON, M_PER_DEG_LAT, M_PER_DEG_LON, fly, square_fleet

pytestmark = pytest.mark.integration


@contextlib.contextmanager
def ending(process):
    """Kill the process if the test leaves it running."""
    try:
        yield
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


@pytest.mark.parametrize("addresses", [1, 300])
def test_a_vehicle_is_located_under_a_flood_of_false_positions_noise_and_made_up_vehicles(tmp_path, free_port, addresses):
    # The log goes to a file, for nobody would read a pipe meanwhile.
    with (tmp_path / "log").open("w") as log_file:
        command = [sys.executable, "-m", "gcs_coloc", "--udp", f"127.0.0.1:{free_port}"]
        service = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log_file)
    with square_fleet(free_port) as fleet, ending(service):
        fly(fleet, 60.0, until=lambda: all(v.of("HEARTBEAT") for v in fleet))
        flood = subprocess.Popen(
            [sys.executable, "-m", "bench.flood_sender", str(free_port), "20000", "60", str(addresses)], stdout=subprocess.DEVNULL
        )
        try:
            fly(fleet, 2.0)
            fly(fleet, 60.0, failed=[4], until=lambda: sum(m.fix_type == 3 for m in fleet[3].of("GPS_INPUT")) >= 20)
            assert flood.poll() is None
        finally:
            flood.kill()
            flood.wait()
        fixes = [m for m in fleet[3].of("GPS_INPUT") if m.fix_type == 3]
        assert len(fixes) >= 20
        for fix in fixes:
            # The flood says that these vehicles are anywhere on Earth; 4 sigma of what their own positions and ranges give.
            east, north = (fix.lon / 1e7 - LON) * M_PER_DEG_LON, (fix.lat / 1e7 - LAT) * M_PER_DEG_LAT
            assert math.hypot(east - fleet[3].enu_m[0], north - fleet[3].enu_m[1]) < 4.0
        assert not any(v.of("GPS_INPUT") for v in fleet[:3])
        service.send_signal(signal.SIGINT)
        assert service.wait(60) == 0
    log = (tmp_path / "log").read_text()
    assert "Traceback" not in log
    assert "address_conflict" in log
    assert "refused on the links" in log
