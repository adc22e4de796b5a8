"""Two autopilots with one system id are told from one that reboots, wraps, drifts or is late."""

from __future__ import annotations

import random
from dataclasses import replace

from engine_flights import StraightLine, aids, fly, settings, telemetry

from gcs_coloc.core.clocks.vehicle_clocks import DuplicateIdDetector
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.inbound import GlobalPosition, GpsReceiver
from gcs_coloc.core.messages.outbound import Notice

WRAP_S = 2**32 / 1e3


def seen_at(stamps: list[tuple[float, float]]) -> list[float]:
    """The arrival times at which two clocks are seen in stamps of (boot time, arrival time)."""
    clocks, out = DuplicateIdDetector(), []
    for stamp_s, received_at_s in stamps:
        clocks.add(stamp_s, received_at_s)
        if clocks.detected(received_at_s):
            out.append(received_at_s)
    return out


def test_two_clocks_that_take_turns_are_seen_within_six_seconds_and_forgotten_when_one_is_silent():
    both = [(t + boot, t) for k in range(40) for t, boot in ((k * 0.5, 100.0), (k * 0.5 + 0.2, 5000.0))]
    told = seen_at([*both, *((t + 100.0, t) for t in range(20, 60))])
    assert 5.0 < told[0] < 6.5
    assert 28.0 < told[-1] < 30.0  # 10 s after the last turn that counted


def test_two_clocks_that_speak_once_a_second_in_bursts_are_seen():
    assert seen_at([(t + boot + i * 1e-3, t + i * 1e-3) for t in range(20) for boot in (100.0, 130.0) for i in range(4)])


def test_one_clock_that_reboots_again_and_again_wraps_drifts_or_is_late_is_one():
    draw = random.Random(4)
    times = [k * 0.1 for k in range(1200)]
    assert not seen_at([(t % 25.0, t) for t in times])
    assert not seen_at([((t + WRAP_S - 60.0) % WRAP_S, t) for t in times])
    assert not seen_at([(t * 1.0002, t) for t in times])
    assert not seen_at([(t - draw.expovariate(1.0), t) for t in times])


def test_a_backlog_that_comes_among_fresh_frames_is_no_second_clock():
    fresh = [(100.0 + t, t) for t in (k * 0.1 for k in range(300))]
    # 40 s of frames that waited in a modem, let out at eight times their pace.
    backlog = [(60.0 + 0.1 * k, 10.0 + 0.0125 * k) for k in range(400)]
    assert not seen_at(sorted(fresh + backlog, key=lambda pair: pair[1]))


def test_two_autopilots_behind_one_address_get_nothing_are_no_anchor_and_are_told_of_until_one_is_gone():
    estimator = StraightLine()
    engine = Engine(estimator, settings())

    def duplicate_id(begin_s: float, end_s: float, fix_type: int) -> list:
        out = []
        for k in range(round((end_s - begin_s) * 10)):
            t = begin_s + 0.1 * k
            out += fly(engine, t, t + 0.1, failed=[4] if fix_type < 3 else [])
            for message in telemetry(4, t + 0.05):
                if isinstance(message, GlobalPosition):
                    message = replace(message, boot_s=message.boot_s + 1000.0, lat_deg=message.lat_deg + 0.01)
                if isinstance(message, GlobalPosition | GpsReceiver):
                    engine.receive(message)
        return out

    fly(engine, 0.0, 3.0)
    out = duplicate_id(3.0, 10.0, fix_type=3)
    told = [o.text for _, o in out if isinstance(o, Notice) and o.level == "error" and o.sysid == 4]
    assert len(told) == 1
    assert told[0].startswith("two autopilots use its system id; give each its own")
    assert engine.snapshot(10.0).vehicles[3].gps_state == "suspect"
    assert not aids(duplicate_id(10.0, 20.0, fix_type=1), 4)
    assert "NOT SENT: two autopilots" in engine.snapshot(20.0).vehicles[3].aiding
    back = fly(engine, 20.0, 40.0, failed=[4])
    assert 3 in {a.fix_type for t, a in aids(back, 4) if t > 32.0}
