"""TIMESYNC through the whole loop: the fakes' clocks found through their jittered links, and aid that is not late."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest

from gcs_coloc.core.aiding import stream as aid_stream
from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.study.closed_loop import ClosedLoop, Flight
from sitl_fakes.scenario import SCENARIOS, load_scenario

SCENARIO = SCENARIOS / "uwb.toml"
LOST_S, SETTLED_S, ENDS_S = 20.0, 30.0, 45.0


def navigation_rms_m(flight: Flight) -> float:
    late = [s.truth for s in flight.samples[4] if s.at_s >= SETTLED_S]
    off = [np.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m) for t in late]
    return float(np.sqrt(np.mean(np.square(off))))


def test_the_vehicle_is_told_where_it_is_when_it_hears_it(monkeypatch):
    loop = ClosedLoop(load_scenario(SCENARIO), 7, Engine(load_estimator("fleet", {})))
    loop.advance(LOST_S - 1.0)  # until then there is no aid that could be late
    unaware = deepcopy(loop)
    loop.advance(ENDS_S)
    engine, aware = loop.engine, loop.flight
    for sysid in engine.sysids():
        # The link takes 50 ms and up to 100 ms more; the fakes read what has arrived every 20 ms.
        assert engine.clocks.boot_clock(sysid).one_way_delay_s(ENDS_S) == pytest.approx(0.05 + 0.005, abs=0.01)
        method, sigma_s = engine.clocks.boot_clock(sysid).quality(ENDS_S)
        assert method == "TIMESYNC"
        assert sigma_s < 0.01
    assert not [reason for reason in engine.refused() if reason.startswith("timesync")]
    monkeypatch.setattr(aid_stream, "_LONGEST_LEAD_S", 0.0)
    unaware.advance(ENDS_S)
    # 50 ms of 100 ms mean delay at 22 m/s: 1.1 m of a systematic error that points backwards.
    assert navigation_rms_m(aware) < navigation_rms_m(unaware.flight) - 0.5
