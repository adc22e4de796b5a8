"""An engine flown by hand-moved time: a fleet's telemetry, an estimator that knows a straight line, and what comes out."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from math import inf, pi

import numpy as np

from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, NoEstimateReason, Unlocated
from gcs_coloc.core.messages.control import RouteReport
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    Autopilot,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Inbound,
    ParameterValue,
)
from gcs_coloc.core.messages.outbound import GpsInput, Notice
from gcs_coloc.core.snapshot import VehicleSnapshot

LAT, LON, ALT = 47.0, 8.0, 500.0
M_PER_DEGREE_EAST = 76056.0
M_APART_NORTH = 111.2
"""How far each vehicle is north of the one before it, m: a thousandth of a degree."""


class StraightLine:
    """An estimator for these tests: each vehicle flies east at 20 m/s where its telemetry says, the first through the origin."""

    name = "straight line"

    def __init__(self) -> None:
        self.taken: list[Measurement] = []
        self.denied: list[tuple[frozenset[int], float]] = []
        self.resets: list[tuple[int, float]] = []
        self.asked: list[tuple[int, float]] = []
        self.sigma_m = 2.0
        self.sigma_v_m = 3.0
        self.unknown: str | None = None
        self.ranges_in_use = 3
        self.refuses_air_data = False
        self.air_data_at_s = inf

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        self.denied.append((frozenset(denied), at_s))

    def reset(self, vehicle: int, at_s: float) -> None:
        self.resets.append((vehicle, at_s))

    def add(self, measurement: Measurement) -> None:
        self.taken.append(measurement)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        self.asked.append((vehicle, at_s))
        if self.unknown is not None:
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER, detail=self.unknown))
        covariance = np.diag([self.sigma_m**2, 1.0, self.sigma_v_m**2, 0.25, 0.16, 0.04])
        place = np.array([20.0 * at_s, (vehicle - 1) * M_APART_NORTH, 30.0])
        velocity, refuses = np.array([20.0, 0.0, 1.0]), self.refuses_air_data
        found = Estimate(vehicle, at_s, place, velocity, covariance, 1.5, self.ranges_in_use, refuses_air_data=refuses)
        return replace(found, air_data_at_s=self.air_data_at_s)

    def drain_residuals(self) -> list:
        return []

    def counts(self) -> dict[str, int]:
        return {}

    def of(self, kind: type, vehicle: int) -> list[Measurement]:
        return [m for m in self.taken if isinstance(m, kind) and vehicle in (getattr(m, "vehicle", None),)]


def settings(**changes: object) -> EngineSettings:
    return EngineSettings(request_streams=False, **changes)


def telemetry(sysid: int, t: float, fix_type: int = 3, autopilot: Autopilot = Autopilot.ARDUPILOT) -> Iterable[Inbound]:
    boot = t + 10.0 * sysid
    step = round(t * 10)
    lon_deg = LON + 20.0 * t / M_PER_DEGREE_EAST
    yield GlobalPosition(sysid, t, boot, LAT + 0.001 * sysid, lon_deg, ALT + 30, 0.0, 20.0, 0.0)
    # Without them nothing shows where it went while it has no ranges, and its protection level grows by all it may have done.
    yield Attitude(sysid, t, boot, 0.0, 0.0, 0.5 * pi)
    yield Airspeed(sysid, t, 20.0)
    if step % 2 == 0:
        yield GpsReceiver(
            sysid, t, 0, fix_type, LAT + 0.001 * sysid, lon_deg, ALT + 30, 10 if fix_type >= 3 else 3, 1.0, 1.2, 2.0, 0.4
        )
    if step % 10 == 0:
        yield Heartbeat(sysid, t, autopilot, True, winged=True)
        yield RouteReport(sysid, t, None)


def fly(
    engine: Engine,
    start_s: float,
    stop_s: float,
    failed: Collection[int] = (),
    sysids: Collection[int] = (1, 2, 3, 4),
    autopilot: Autopilot = Autopilot.ARDUPILOT,
) -> list:
    """Feed 10 Hz telemetry and poll at every deadline, as the service does; returns (time, output) pairs."""
    out = []
    for step in range(round(start_s * 10), round(stop_s * 10)):
        t = step / 10
        for sysid in sysids:
            for message in telemetry(sysid, t, 1 if sysid in failed else 3, autopilot):
                engine.receive(message)
        while engine.next_deadline() < t + 0.1:
            now_s = max(engine.next_deadline(), t)
            out.extend((now_s, o) for o in engine.poll(now_s))
    return out


def aids(out: list, sysid: int) -> list[tuple[float, GpsInput]]:
    return [(t, o) for t, o in out if isinstance(o, GpsInput) and o.sysid == sysid]


def vehicle_4(engine: Engine, now_s: float) -> VehicleSnapshot:
    return next(v for v in engine.snapshot(now_s).vehicles if v.sysid == 4)


def parameters_told(engine: Engine, now_s: float, **values: float) -> None:
    for name, value in values.items():
        engine.receive(ParameterValue(4, now_s, name, value, 2))


def texts(out: list, sysid: int = 4) -> list[str]:
    return [o.text for _, o in out if isinstance(o, Notice) and o.sysid == sysid]
