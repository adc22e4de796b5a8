"""A fleet of the fakes flown against the engine in one process, on MAVLink bytes and simulated time, while something goes wrong.

What is asked of an outcome is what counts in the air: whom the service trusted and when, whether it stated a fix, how far that
was off the truth in units of what it stated, and how far off the truth the autopilot that took it believed itself to be.
"""

from __future__ import annotations

import json
import pickle
import tomllib
from dataclasses import dataclass
from functools import lru_cache
from math import hypot
from typing import Any, Literal

from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.error_ellipse import horizontal_bound_95_m
from gcs_coloc.core.messages.outbound import GpsInput, Notice, Outbound
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.study.closed_loop import ClosedLoop, Flight, Sample
from sitl_fakes.faults import Fault
from sitl_fakes.fleet import STEP_S
from sitl_fakes.scenario import SCENARIOS, Scenario

DENIED = 4
"""The aircraft in the middle of the four-ship, which loses its GPS in most hazards."""
_FIRST_FAULT_S = 15.0
"""When the first fault of most flights begins; a flight of which it begins later shares what comes before."""
FROM_S = 25.0
"""When a hazard begins that befalls a fleet whose denied vehicle has been located by then."""
PEER, OTHERS = 1, {2, 3}
"""The peer that a hazard befalls, and those that nothing befalls."""
SOUND_M, HONEST = 6.0, 1.5
"""Limits of the error, in m and in units of the 95 % bound.

The four-ship of sitl_fakes/scenarios/uwb.toml has GPS of 1.5 m with errors that last a minute, ranges of 0.5 m with 3 % outliers,
and telemetry up to 0.15 s late. Undisturbed, over seeds 1 to 8, the vehicle is located to 4.0 m at the worst, and `SOUND_M` is
half as much again; and to 1.5 times its 95 % bound at the worst, as the peers' slow errors last a whole flight; with the seed of
these flights to 0.7 times, so that `HONEST` leaves room for as much again and nothing for a fault.
"""
SwitchPrimary = Literal["off", "auto"]


class _Watched(Engine):
    """An engine that keeps what it sends and says, with the time."""

    def __init__(self, switch_primary: SwitchPrimary) -> None:
        super().__init__(load_estimator("fleet", {}), EngineSettings(aiding=AidingSettings(switch_primary=switch_primary)))
        self.said: list[tuple[float, Outbound]] = []

    def poll(self, now_s: float) -> list[Outbound]:
        out = super().poll(now_s)
        self.said += [(now_s, message) for message in out]
        return out


@dataclass(frozen=True)
class Stated:
    """A moment at which the service stated where a vehicle is: its error and its 95 % bound, horizontal, m."""

    at_s: float
    error_m: float
    bound_m: float


@dataclass
class Outcome:
    """What a flight came to. Times are seconds since the start. `gps_reasons`: what spoke for each GPS state at the end."""

    flight: Flight
    said: list[tuple[float, Outbound]]
    refused: dict[str, int]
    gps_reasons: dict[int, str]

    def first(self, sysid: int, *states: str, after_s: float = 0.0) -> float:
        """When a vehicle's GPS health first became one of some states; infinity for never."""
        times = (c.at_s for c in self.flight.changes if c.sysid == sysid and c.after in states and c.at_s >= after_s)
        return min(times, default=float("inf"))

    def distrusted(self, after_s: float) -> set[int]:
        """Vehicles whose GPS was called failed after a time."""
        return {c.sysid for c in self.flight.changes if c.after == "failed" and c.at_s >= after_s}

    def reason(self, sysid: int, state: str) -> str:
        """The words with which a vehicle's GPS first came into a state."""
        return next(c.reason for c in self.flight.changes if c.sysid == sysid and c.after == state)

    def fix_types(self, sysid: int, from_s: float, to_s: float = float("inf")) -> list[int]:
        """Fix types of the GPS_INPUT sent to a vehicle within a time."""
        return [m.fix_type for t, m in self.said if isinstance(m, GpsInput) and m.sysid == sysid and from_s <= t < to_s]

    def share_located(self, sysid: int, from_s: float, to_s: float = float("inf")) -> float:
        """Share of the GPS_INPUT within a time that stated a fix."""
        types = self.fix_types(sysid, from_s, to_s)
        return sum(t == 3 for t in types) / len(types)

    def stated(self, sysid: int, from_s: float, to_s: float = float("inf")) -> list[Stated]:
        """The moments within a time at which the last GPS_INPUT to a vehicle stated a fix."""
        sends = [(t, m.fix_type) for t, m in self.said if isinstance(m, GpsInput) and m.sysid == sysid]
        out, k, has_fix = [], 0, False
        for sample in self.flight.samples[sysid]:
            while k < len(sends) and sends[k][0] <= sample.at_s:
                has_fix, k = sends[k][1] == 3, k + 1
            fresh = k > 0 and sample.at_s - sends[k - 1][0] < 1.0
            if has_fix and fresh and from_s <= sample.at_s < to_s and sample.error_enu_m is not None:
                assert sample.covariance is not None
                error_m = hypot(float(sample.error_enu_m[0]), float(sample.error_enu_m[1]))
                out.append(Stated(sample.at_s, error_m, horizontal_bound_95_m(sample.covariance)))
        return out

    def worst_stated_m(self, sysid: int, from_s: float, to_s: float = float("inf")) -> float:
        """The largest error among what was stated as a fix within a time, m."""
        return max((s.error_m for s in self.stated(sysid, from_s, to_s)), default=0.0)

    def worst_ratio(self, sysid: int, from_s: float, to_s: float = float("inf")) -> float:
        """The largest error within a time in units of the 95 % bound that was stated with it."""
        return max((s.error_m / s.bound_m for s in self.stated(sysid, from_s, to_s)), default=0.0)

    def worst_belief_m(self, sysid: int, from_s: float, to_s: float = float("inf")) -> float:
        """How far the vehicle's autopilot believed itself from where it was, at most, within a time, m."""
        return max(_belief_error_m(s) for s in self.flight.samples[sysid] if from_s <= s.at_s < to_s)

    def warnings(self, sysid: int) -> list[tuple[float, str]]:
        """What the operator was warned of about a vehicle, with the time."""
        return [(t, m.text) for t, m in self.said if isinstance(m, Notice) and m.sysid == sysid and m.level == "warning"]

    def words(self, sysid: int) -> list[str]:
        """What the operator was told about a vehicle."""
        return [m.text for _, m in self.said if isinstance(m, Notice) and m.sysid == sysid]


def _belief_error_m(sample: Sample) -> float:
    t = sample.truth
    if t.estimate_east_m is None or t.estimate_north_m is None:
        return float("inf")
    return hypot(t.estimate_east_m - t.east_m, t.estimate_north_m - t.north_m)


def fault(kind: str, vehicle: int = DENIED, at_s: float = _FIRST_FAULT_S, **more: Any) -> dict[str, Any]:
    """A fault of a scenario; by default it befalls the denied vehicle at 15 s."""
    return {"kind": kind, "vehicle": vehicle, "at_s": at_s, **more}


LOST = fault("gps_lost")


def fly_through(
    *faults: dict[str, Any],
    duration_s: float,
    seed: int = 1,
    mutual: bool = False,
    params: dict[str, float] | None = None,
    autopilot: str = "ardupilot",
    scenario: str = "uwb",
    switch_primary: SwitchPrimary = "off",
) -> Outcome:
    """Fly a scenario of configs/ with faults in place of its own.

    Args:
        faults: as in a scenario file.
        duration_s: how long.
        seed: of all noise.
        mutual: whether all measure ranges, not the denied vehicle alone.
        params: autopilot parameters of the denied vehicle.
        autopilot: kind of the denied vehicle's autopilot.
        scenario: name of the scenario.
        switch_primary: whether a faulty receiver is switched off.
    """
    with (SCENARIOS / f"{scenario}.toml").open("rb") as file:
        table = tomllib.load(file)
    table["fault"] = []
    everyone = [v["sysid"] for v in table["vehicle"]]
    losers = {f["vehicle"] for f in faults if f["kind"].startswith("gps_")} | {DENIED}
    for vehicle in table["vehicle"]:
        if mutual or vehicle["sysid"] in losers:
            vehicle["ranges_to"] = [peer for peer in everyone if peer != vehicle["sysid"]]
        if vehicle["sysid"] == DENIED:
            vehicle["params"] = {**vehicle.get("params", {}), **(params or {})}
            vehicle["autopilot"] = autopilot
    if autopilot == "px4":
        table["ranging"]["message"] = "debug_vect"  # it does not forward its companion's PEER_RANGE
    ordered = sorted(faults, key=lambda f: f["at_s"])
    befall = Scenario.model_validate(table | {"fault": ordered}).fault
    loop = _flown(json.dumps(table), seed, switch_primary, tuple(befall), duration_s)
    engine = loop.engine
    assert isinstance(engine, _Watched)
    gps_reasons = {vehicle.sysid: vehicle.gps_reason for vehicle in engine.snapshot(duration_s).vehicles}
    return Outcome(loop.flight, engine.said, engine.refused(), gps_reasons)


def _flown(scenario: str, seed: int, switch_primary: SwitchPrimary, faults: tuple[Fault, ...], until_s: float) -> ClosedLoop:
    """Fly a scenario (JSON) with faults, in order of time. What comes before the last one begins is flown once for all tests."""
    if faults:
        loop = pickle.loads(_beginning(scenario, seed, switch_primary, faults[:-1], faults[-1].at_s - STEP_S))
        loop.fleet.inject(faults[-1])
    elif until_s > _FIRST_FAULT_S:
        loop = pickle.loads(_beginning(scenario, seed, switch_primary, (), _FIRST_FAULT_S - STEP_S))
    else:
        loop = ClosedLoop(Scenario.model_validate_json(scenario), seed, _Watched(switch_primary))
    loop.advance(until_s)
    return loop


@lru_cache(maxsize=16)
def _beginning(scenario: str, seed: int, switch_primary: SwitchPrimary, faults: tuple[Fault, ...], until_s: float) -> bytes:
    """A flight as far as a time, to go on from: pickled, as to read that is several times faster than a deep copy."""
    return pickle.dumps(_flown(scenario, seed, switch_primary, faults, until_s), pickle.HIGHEST_PROTOCOL)
