"""A fleet with GPS that ranges one of its vehicles, through the engine with the fleet filter: for tests of readiness."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import atan2, dist, hypot

import numpy as np

from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.estimator import Estimator
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.messages.control import RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    Autopilot,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Inbound,
    PeerRange,
    TimeBase,
)
from gcs_coloc.core.messages.outbound import Notice, Outbound
from gcs_coloc.core.readiness.vehicle_readiness import VehicleReadiness
from gcs_coloc.estimators.fleet.filter import FleetFilter

FRAME = LocalFrame(47.0, 8.0, 500.0)
RANGED = 1
"""The vehicle that ranges all others."""


@dataclass(frozen=True)
class Flying:
    """Where a vehicle is at time 0 (east, north, up, m) and its velocity, m/s."""

    place: Vector3
    velocity: Vector3 = (0.0, 0.0, 0.0)

    def at(self, t: float) -> Vector3:
        (e, n, u), (ve, vn, vu) = self.place, self.velocity
        return e + ve * t, n + vn * t, u + vu * t


@dataclass
class ReadyFleet:
    """Vehicles on straight ways; vehicle 1 ranges the others five times a second while they are in `ranged`.

    `every`: of how many fifths of a second one has messages.
    """

    vehicles: Mapping[int, Flying]
    h_acc_m: float = 1.0
    range_sigma_m: float = 1.0
    max_range_m: float = 1e5
    armed: bool = True
    winged: bool = True
    every: int = 1
    seed: int = 1
    settings: EngineSettings = field(default_factory=lambda: EngineSettings(request_streams=False))
    estimator: Estimator = field(default_factory=FleetFilter)

    def __post_init__(self) -> None:
        self.engine = Engine(self.estimator, self.settings)
        self.ranged = [sysid for sysid in self.vehicles if sysid != RANGED]
        self.fix_types = dict.fromkeys(self.vehicles, 3)
        self.seen: list[VehicleReadiness] = []
        self.outputs: list[Outbound] = []
        self.blocked = False
        self.t = 0.0
        self._rng = np.random.default_rng(self.seed)

    def fly(self, until_s: float) -> VehicleReadiness | None:
        """Fly on; return the readiness of vehicle 1. All that was stated of it is in `seen`."""
        while self.t < until_s - 1e-9:
            for message in self._messages() if round(self.t * 5) % self.every == 0 else ():
                self.engine.receive(message)
            while self.engine.next_deadline() < self.t + 0.2:
                self.outputs += self.engine.poll(max(self.engine.next_deadline(), self.t))
                now = self.readiness()
                if now is not None and (not self.seen or self.seen[-1].at_s != now.at_s):
                    self.seen.append(replace(now))
            self.t = round(self.t + 0.2, 3)
        return self.readiness()

    def readiness(self) -> VehicleReadiness | None:
        return self.engine.readiness(RANGED)

    @property
    def notices(self) -> list[str]:
        return [output.text for output in self.outputs if isinstance(output, Notice)]

    def _messages(self) -> list[Inbound]:
        t, out = self.t, []
        for sysid, flying in self.vehicles.items():
            e, n, u = flying.at(t)
            ve, vn, vu = flying.velocity
            noise = self._rng.normal(0.0, 0.2, 2)
            lat, lon, alt = FRAME.geodetic_from_enu(e + noise[0], n + noise[1], u)
            fix_type = self.fix_types[sysid]
            out.append(GlobalPosition(sysid, t, t, lat, lon, alt, vn, ve, -vu))
            if round(t * 5) % 5 == 0:
                out.append(Heartbeat(sysid, t, Autopilot.ARDUPILOT, self.armed, winged=self.winged))
                out.append(RouteReport(sysid, t, RouteBlock.NO_HEARTBEAT if self.blocked else None))
            out.append(GpsReceiver(sysid, t, 0, fix_type, lat, lon, alt, 10, 1.0, self.h_acc_m, 1.6 * self.h_acc_m, 0.3))
            if self.winged:
                out.append(Attitude(sysid, t, t, 0.0, 0.0, atan2(ve, vn)))
                out.append(Airspeed(sysid, t, hypot(ve, vn)))
        here = self.vehicles[RANGED].at(t)
        for sysid in self.ranged:
            metres = dist(here, self.vehicles[sysid].at(t))
            if metres <= self.max_range_m:
                measured = metres + float(self._rng.normal(0.0, self.range_sigma_m))
                out.append(PeerRange(RANGED, t, sysid, measured, self.range_sigma_m, t, TimeBase.SERVICE, None, None, 0))
        return out


def abreast(*places: tuple[float, float], speed_mps: float = 20.0) -> dict[int, Flying]:
    """Return planes that fly north side by side, vehicle 1 in the origin and the others at some places (east, north, m)."""
    north = (0.0, speed_mps, 0.0)
    others = {2 + k: Flying((e, n, 100.0 + 20.0 * k), north) for k, (e, n) in enumerate(places)}
    return {RANGED: Flying((0.0, 0.0, 110.0), north), **others}


AROUND = ((800.0, 100.0), (-500.0, 700.0), (-300.0, -800.0), (300.0, 900.0))
"""Four places with good geometry."""
