"""A vehicle that never had GPS, far from the frame's origin: its height is one over its own place, not over the origin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.integrity_flights import DENIED, ORIGIN, STEP_S, Flight, Scenario, fresh_engine
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.inbound import FromVehicle, GlobalPosition, GpsReceiver

M_PER_DEGREE_LAT = 111_195.0
BEACON = 50


def moved(message: FromVehicle, there: LocalFrame) -> FromVehicle:
    """The same message of the same flight about another origin, without a fix of the denied vehicle."""
    if isinstance(message, GpsReceiver):
        message = replace(message, fix_type=1 if message.sysid == DENIED else 3)
    if isinstance(message, GlobalPosition | GpsReceiver):
        place = ORIGIN.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m)
        lat, lon, alt = there.geodetic_from_enu(*place)
        return replace(message, lat_deg=lat, lon_deg=lon, alt_msl_m=alt)
    return message


@pytest.mark.parametrize("distance_m", [20_000.0, 40_000.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_first_fixes_are_right_in_height_and_place(distance_m, seed):
    engine, flight = fresh_engine(), Flight(Scenario(lost=False), seed)
    origin = ORIGIN.lat_deg, ORIGIN.lon_deg, 400.0
    engine.receive(GpsReceiver(BEACON, 0.0, 0, 3, *origin, 12, 0.9, 1.5, 1.5, 0.2, 0.0))
    engine.receive(GlobalPosition(BEACON, 0.0, 0.0, *origin, 0.0, 0.0, 0.0))
    there = LocalFrame(ORIGIN.lat_deg + distance_m / M_PER_DEGREE_LAT, ORIGIN.lon_deg, 400.0)
    off = []
    for step in range(round(20.0 / STEP_S)):
        t = step * STEP_S
        for message in flight.messages(t):
            engine.receive(moved(message, there))
        engine.poll(t)
        where = engine.estimate(DENIED, t)
        if isinstance(where, Estimate) and engine.frame is not None:
            true_m = there.geodetic_from_enu(*(float(x) for x in flight.courses[DENIED].at(t)[0]))
            true_enu_m = np.array(engine.frame.enu_from_geodetic(*true_m))
            off.append(np.abs(where.position_enu_m - true_enu_m) / np.sqrt(np.diag(where.covariance)[:3]))
    assert len(off) > 60
    assert np.max(off) < 4.0
