"""Receivers that state an airport or another altitude, through the engine: told in seconds, and nobody else loses the fix."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import cos, degrees, hypot, inf, radians

import pytest

from bench.integrity_flights import DENIED, LOST_AT_S, STEP_S, Flight, Scenario, error_and_bound_m, fresh_engine
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.measurements import NoEstimate, NoEstimateReason
from gcs_coloc.core.messages.inbound import FromVehicle, GlobalPosition, GpsReceiver

EARTH_RADIUS_M = 6_371_000.0
SPOOFED = 1
JUMPS_AT_S = 16.0


@dataclass
class Flown:
    """When vehicles became FAILED, s, who else was ever not healthy, and what the denied vehicle had from its loss on."""

    engine: Engine
    failed_s: dict[int, float] = field(default_factory=dict)
    disturbed: set[int] = field(default_factory=set)
    fixes: int = 0
    deadlines: int = 0
    largest_share_of_bound: float = 0.0

    @property
    def fix_share(self) -> float:
        return self.fixes / self.deadlines


def elsewhere(message: FromVehicle, east_m: float, north_m: float, up_m: float) -> FromVehicle:
    """The same message from a place along the earth's surface and above."""
    if not isinstance(message, GlobalPosition | GpsReceiver):
        return message
    lon_radius_m = EARTH_RADIUS_M * cos(radians(message.lat_deg))
    return replace(
        message,
        lat_deg=message.lat_deg + degrees(north_m / EARTH_RADIUS_M),
        lon_deg=message.lon_deg + degrees(east_m / lon_radius_m),
        alt_msl_m=message.alt_msl_m + up_m,
    )


def fly(
    *,
    spoofed: int,
    off_m: float = 0.0,
    up_m: float = 0.0,
    from_s: float,
    mutual: bool,
    until_s: float,
    lost: bool = True,
    first: int = 0,
) -> Flown:
    engine, flight = fresh_engine(), Flight(Scenario(mutual=mutual, lost=lost), seed=0)
    east_m, north_m, _ = (off_m * flight.away).tolist()
    flown = Flown(engine)
    for step in range(round(until_s / STEP_S)):
        t = step * STEP_S
        for message in sorted(flight.messages(t), key=lambda message: message.sysid != first):
            engine.receive(elsewhere(message, east_m, north_m, up_m) if message.sysid == spoofed and t >= from_s else message)
        engine.poll(t)
        for sysid in engine.sysids():
            state = engine.gps_state(sysid)
            if state is GpsState.FAILED:
                flown.failed_s.setdefault(sysid, t)
            if state not in (GpsState.HEALTHY, GpsState.UNKNOWN):
                flown.disturbed.add(sysid)
        if t > LOST_AT_S + 3.0:
            flown.deadlines += 1
            stated = error_and_bound_m(engine, flight, t)
            if stated is not None:
                flown.fixes += 1
                flown.largest_share_of_bound = max(flown.largest_share_of_bound, stated[0] / stated[1])
    return flown


@pytest.mark.parametrize("mutual", [True, False])
@pytest.mark.parametrize("off_m", [20_000.0, 300_000.0])
def test_a_peer_that_jumps_there_in_flight_costs_no_more_than_a_second_of_the_fix(off_m, mutual):
    flown = fly(spoofed=SPOOFED, off_m=off_m, from_s=JUMPS_AT_S, mutual=mutual, until_s=JUMPS_AT_S + 10.0)
    assert flown.deadlines - flown.fixes <= 1.0 / STEP_S
    assert flown.largest_share_of_bound < 1.5
    assert flown.disturbed == {SPOOFED, DENIED}
    assert not mutual or flown.failed_s[SPOOFED] <= JUMPS_AT_S + 4.0


@pytest.mark.parametrize("mutual", [True, False])
def test_a_peer_that_is_there_from_the_start_is_named(mutual):
    flown = fly(spoofed=SPOOFED, off_m=300_000.0, from_s=-inf, mutual=mutual, until_s=15.0, first=2)
    assert flown.failed_s[SPOOFED] <= 8.0
    assert flown.disturbed == {SPOOFED, DENIED}
    assert flown.fix_share == 1.0
    assert flown.largest_share_of_bound < 1.5


@pytest.mark.parametrize("mutual", [True, False])
def test_a_peer_whose_altitude_jumps_is_no_anchor_and_the_others_stay_so(mutual):
    flown = fly(spoofed=SPOOFED, up_m=300.0, from_s=JUMPS_AT_S, mutual=mutual, until_s=JUMPS_AT_S + 20.0)
    assert flown.fix_share > 0.98
    assert flown.largest_share_of_bound < 1.5
    assert flown.disturbed == {SPOOFED, DENIED}


def test_a_vehicle_whose_own_receiver_jumps_there_is_located_and_failed():
    flown = fly(spoofed=DENIED, off_m=300_000.0, from_s=JUMPS_AT_S, mutual=False, until_s=JUMPS_AT_S + 6.0, lost=False)
    assert flown.failed_s[DENIED] <= JUMPS_AT_S + 4.0
    assert flown.disturbed == {DENIED}
    where = flown.engine.estimate(DENIED, JUMPS_AT_S + 6.0)
    assert not isinstance(where, NoEstimate)
    assert hypot(*where.position_enu_m[:2]) < 5_000.0


def test_a_fleet_beyond_the_plane_of_an_origin_that_a_false_position_has_set_is_not_located():
    flown = fly(spoofed=SPOOFED, off_m=1_500_000.0, from_s=-inf, mutual=True, until_s=12.0, first=SPOOFED)
    assert flown.fixes == 0
    where = flown.engine.estimate(DENIED, 12.0)
    assert isinstance(where, NoEstimate)
    assert where.reason.reason is NoEstimateReason.FAR_FROM_ORIGIN
    assert "restart the service" in where.reason.text
