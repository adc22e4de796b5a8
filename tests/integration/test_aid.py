"""Aid over real sockets: somebody else's GPS_INPUT, passed on by the vehicle, makes ours stand down, in flight and in replay."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from vehicles import Hover, fly, square_fleet

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.outbound import GpsInput, Notice
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader

pytestmark = pytest.mark.integration

STANDS_DOWN = "system 255 sends it GPS_INPUT for receiver 1: ours stands down"


def pass_on_gps_input(vehicle: Hover, ground_station: mavlink.MAVLink) -> None:
    """What a vehicle does with a message that has no target: it sends it on over its other links."""
    place = (round(vehicle.lla[0] * 1e7), round(vehicle.lla[1] * 1e7), vehicle.lla[2])
    fix = mavlink.MAVLink_gps_input_message(0, 1, 0, 0, 0, 3, *place, 1.0, 1.0, 0.0, 0.0, 0.0, 0.5, 2.0, 3.0, 10)
    vehicle.send(bytes(fix.pack(ground_station)))
    ground_station.seq = (ground_station.seq + 1) & 0xFF


def replayed(tlog: Path) -> tuple[list[float], list[tuple[float, str]]]:
    """When a replay sends vehicle 4 GPS_INPUT, and what it says of it."""
    sent, told = [], []

    def on_poll(at_s, outputs):
        sent.extend(at_s for o in outputs if isinstance(o, GpsInput) and o.sysid == 4)
        told.extend((at_s, o.text) for o in outputs if isinstance(o, Notice) and o.sysid == 4)

    replay(Replay(Engine(load_estimator("fleet", {})), TlogReader(tlog), [], on_poll))
    return sent, told


def test_somebody_elses_gps_input_ends_ours_and_the_replay_says_so_too(start_service, free_port, tmp_path):
    service = start_service("--udp", f"127.0.0.1:{free_port}", "--no-web", "--record", str(tmp_path))
    ground_station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    with square_fleet(free_port) as fleet:
        fly(fleet, 3.0)
        fly(fleet, 60.0, failed=[4], until=lambda: any(m.fix_type == 3 for m in fleet[3].of("GPS_INPUT")))
        for _ in range(30):
            pass_on_gps_input(fleet[3], ground_station)
            fly(fleet, 0.1, failed=[4])
        # What was under way has arrived; from here on nothing may come while the other one goes on.
        before = len(fleet[3].of("GPS_INPUT"))
        assert before > 0
        for _ in range(20):
            pass_on_gps_input(fleet[3], ground_station)
            fly(fleet, 0.1, failed=[4])
        assert len(fleet[3].of("GPS_INPUT")) == before
        service.send_signal(signal.SIGINT)
        assert service.wait(60) == 0
    assert STANDS_DOWN in service.stderr.read()
    (tlog,) = tmp_path.glob("*.tlog")
    sent, told = replayed(tlog)
    (stood_down_at_s,) = [at_s for at_s, text in told if text == STANDS_DOWN]
    assert sent
    assert max(sent) <= stood_down_at_s
