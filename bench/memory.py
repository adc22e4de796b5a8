"""Memory over a long run: hours of simulated flight through decoder, engine and encoder at full speed."""

from __future__ import annotations

import os
from pathlib import Path

from bench.figures import Figure
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages import ClockReference, RouteReport
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.decoder import Decoder
from sitl_fakes.fleet import Fleet
from sitl_fakes.scenario import load_scenario

_SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "scenario-uwb.toml"
_LAP_S = 60.0


def measure(quick: bool) -> list[Figure]:
    """One recorded minute with a vehicle without GPS, played over and over on shifted clocks."""
    laps = 10 if quick else 60
    fleet = Fleet(load_scenario(_SCENARIO), seed=1)
    fleet.advance(30.0)
    minute = [(datagram.due_s - 30.0, datagram.sysid, datagram.payload) for datagram in fleet.advance(30.0 + _LAP_S)]
    engine = Engine(load_estimator("fleet", {}))
    engine.receive(ClockReference(0.0, 1.78e9))
    sizes_mb = []
    for lap in range(laps):
        # Each lap is a reboot of all vehicles: clocks jump back, as they do once in a while over hours.
        decoder = Decoder()
        for offset_s, sysid, payload in minute:
            now_s = lap * _LAP_S + offset_s
            while engine.next_deadline() <= now_s:
                engine.poll(max(engine.next_deadline(), 0.0))
            for frame in decoder.decode(payload, now_s, sysid):
                if frame.message is not None:
                    engine.receive(frame.message)
                if frame.is_autopilot_heartbeat:
                    engine.receive(RouteReport(frame.sysid, now_s, None))
        sizes_mb.append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6)
    half, end = sizes_mb[len(sizes_mb) // 2], sizes_mb[-1]
    growth = end / half - 1.0
    return [
        Figure(
            "memory",
            f"growth over the second half of {laps} min",
            f"{growth:+.2%} ({half:.1f} -> {end:.1f} MB)",
            "<= 1 %",
            growth <= 0.01,
        )
    ]
