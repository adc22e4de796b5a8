"""Readiness of random fleets: nothing raises, and what is stated of a vehicle holds together."""

from __future__ import annotations

from math import isfinite

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gcs_coloc.core.readiness.vehicle_readiness import LimitingReason, ReadinessState
from tests.ready_fleet import RANGED, Flying, ReadyFleet

_metres = st.one_of(st.floats(-3000.0, 3000.0), st.sampled_from((0.0, 1.0, 100.0)))
_flying = st.builds(
    Flying,
    st.tuples(_metres, _metres, st.floats(0.0, 300.0)),
    st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0), st.floats(-3.0, 3.0)),
)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(_flying, min_size=1, max_size=6),
    st.floats(0.3, 10.0),
    st.floats(0.1, 30.0),
    st.booleans(),
    st.integers(0, 2**16),
)
def test_random_fleets(ways: list[Flying], h_acc_m: float, range_sigma_m: float, winged: bool, seed: int) -> None:
    vehicles = dict(enumerate(ways, start=RANGED))
    fleet = ReadyFleet(vehicles, h_acc_m=h_acc_m, range_sigma_m=range_sigma_m, winged=winged, seed=seed)
    fleet.fly(9.0)
    for vehicle in fleet.engine.snapshot(9.0).vehicles:
        readiness = vehicle.readiness
        if readiness is None:
            assert vehicle.gps_state != "healthy" or vehicle.sysid > RANGED
            continue
        assert (readiness.reason is None) == (readiness.state is ReadinessState.READY)
        assert bool(readiness.text) == (readiness.reason is not None)
        for value in (readiness.bound_95_now_m, readiness.bound_95_m, readiness.hpl_now_m, readiness.hpl_m, readiness.hdop):
            assert value is None or (isfinite(value) and value > 0.0)
        if readiness.state in (ReadinessState.READY, ReadinessState.DEGRADED):
            assert readiness.hpl_m is not None
            assert readiness.hpl_m <= fleet.settings.aiding.alert_limit_m
        if readiness.reason == LimitingReason.NO_PEER.code:
            assert readiness.peers == 0
    assert "raised an exception" not in fleet.engine.snapshot(9.0).estimator_counts
