"""Aid in the closed loop, over MAVLink bytes on simulated time: what the simulated autopilots do with it."""

from __future__ import annotations

import numpy as np
import pytest

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.study.closed_loop import Flight, fly
from sitl_fakes.faults import GpsJammed, GpsLost, RangeDropout
from sitl_fakes.scenario import Scenario, load_scenario

DENIED = 4
LOST_S = 10.0


def scenario(fault: type, lost_s: float = LOST_S, **ranging: object) -> Scenario:
    uwb = load_scenario("uwb")
    changed = {"fault": [fault(vehicle=DENIED, at_s=lost_s)], "ranging": uwb.ranging.model_copy(update=ranging)}
    return uwb.model_copy(update=changed)


def flown(what: Scenario, duration_s: float, **aid: object) -> tuple[Flight, Engine]:
    engine = Engine(load_estimator("fleet", {}), EngineSettings(aiding=AidingSettings(**aid)))
    return fly(what, 7, engine, duration_s=duration_s), engine


def sources(flight: Flight, from_s: float) -> dict[str, int]:
    seen = [s.truth.source for s in flight.samples[DENIED] if s.at_s >= from_s]
    return {source: seen.count(source) for source in set(seen)}


def off_in_its_own_position_m(flight: Flight, from_s: float) -> float:
    samples = [s.truth for s in flight.samples[DENIED] if s.at_s >= from_s]
    return max(float(np.hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m)) for t in samples)


@pytest.mark.parametrize("switch", ["auto", "off"])
def test_a_jammed_aircraft_flies_on_our_positions_alone_once_its_primary_receiver_is_switched(switch):
    flight, engine = flown(scenario(GpsJammed), 30.0, switch_primary=switch)
    seen = sources(flight, LOST_S + 10.0)
    assert ("gps1" not in seen) is (switch == "auto")
    seen_of_it = next(v for v in engine.snapshot(30.0).vehicles if v.sysid == DENIED)
    assert seen_of_it.gps_primary == ("ours" if switch == "auto" else None)
    assert seen_of_it.fix_acknowledged


def test_standby_fails_over_without_dead_reckoning():
    flight, engine = flown(scenario(GpsLost, 14.0), 28.0, standby=True)
    assert set(sources(flight, 5.0)) == {"gps1", "gps2 injected"}
    assert engine.snapshot(28.0).vehicles[0].aiding == "standby: sending 3D fix"


def test_a_position_too_coarse_for_the_ekf_reaches_the_aircraft_by_external_estimates():
    """It checks the accuracy to align, when it has used no GPS for 10 s: here ranges begin only then."""
    coarse = scenario(GpsLost, sigma_m=30.0, bias_sigma_m=0.0, rate_hz=3.0)
    silent = RangeDropout(vehicle=DENIED, at_s=0.0, until_s=LOST_S + 23.0)
    flight, engine = flown(coarse.model_copy(update={"fault": [*coarse.fault, silent]}), 75.0, alert_limit_m=150.0)
    assert "external position estimates, for it is too coarse for GPS_INPUT" in engine.snapshot(75.0).vehicles[3].aiding
    assert set(sources(flight, 68.0)) == {"dead_reckoning"}  # it uses no GPS, and certainly not ours and the estimates in turns
    assert not [reason for reason in engine.refused() if reason.startswith("external_position")]
    # Within the alert limit, as every position that it was told.
    assert off_in_its_own_position_m(flight, LOST_S + 5.0) < 50.0
