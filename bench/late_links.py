"""Late links and vehicles that do not answer TIMESYNC: the error of a denied vehicle, and which vehicles are distrusted."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from bench.accuracy_runs import on_all_cores
from bench.coverage import NONE, Tally, tally
from bench.figures import Figure
from bench.integrity_flights import DENIED, LOST_AT_S, STEP_S, Scenario, error_and_bound_m, fresh_engine
from bench.wandering import WanderingFlight
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.messages.inbound import FromVehicle, SystemTime

FLIGHT_S = 120.0
_COUNTED_FROM_S = LOST_AT_S + 20.0
_UNIX_S = 1.78e9
_UTC_EVERY_STEPS = round(1.0 / STEP_S)
_UTC_BEHIND_S = (0.05, 0.25)  # an autopilot's UTC: as old as a fix is when it comes in

Delays = Callable[[np.random.Generator, tuple[int, ...]], Mapping[int, float]]


@dataclass(frozen=True, slots=True)
class Late:
    """Least delays of the links by vehicle, s, the mean of what messages wait beyond it, s, and whether the host knows UTC."""

    delays_s: Delays
    wait_s: float = 0.005
    utc: bool = False


@dataclass(frozen=True, slots=True)
class Flown:
    """What was stated, and how many fault-free vehicles were suspect or failed."""

    stated: Tally
    distrusted: int


def all_late(rng: np.random.Generator, vehicles: tuple[int, ...]) -> Mapping[int, float]:  # noqa: ARG001 - as the others
    """Every link half a second late."""
    return dict.fromkeys(vehicles, 0.5)


def one_peer_late(rng: np.random.Generator, vehicles: tuple[int, ...]) -> Mapping[int, float]:  # noqa: ARG001
    """One peer's link half a second late."""
    return dict.fromkeys(vehicles, 0.02) | {vehicles[0]: 0.5}


def denied_late(rng: np.random.Generator, vehicles: tuple[int, ...]) -> Mapping[int, float]:  # noqa: ARG001
    """The denied vehicle's link half a second late."""
    return dict.fromkeys(vehicles, 0.02) | {DENIED: 0.5}


def none_late(rng: np.random.Generator, vehicles: tuple[int, ...]) -> Mapping[int, float]:  # noqa: ARG001
    """Every link 20 ms late."""
    return dict.fromkeys(vehicles, 0.02)


def each_late(rng: np.random.Generator, vehicles: tuple[int, ...]) -> Mapping[int, float]:
    """Each link late by what is drawn for it, up to half a second."""
    return dict(zip(vehicles, rng.uniform(0.0, 0.5, len(vehicles)).tolist(), strict=True))


_KINDS: tuple[tuple[str, Delays], ...] = (
    ("20 ms late", none_late),
    ("one peer 0.5 s late", one_peer_late),
    ("the denied vehicle 0.5 s late", denied_late),
    ("all 0.5 s late", all_late),
    ("each up to 0.5 s late", each_late),
)


def measure(quick: bool) -> list[Figure]:
    """Fly draws of each, with and without UTC, on links that are steady and on links where messages wait."""
    seeds = range(1, (2 if quick else 12) + 1)
    figures = []
    for utc in (False, True):
        for wait_s in (0.005, 0.05):
            for name, delays_s in _KINDS:
                late = Late(delays_s, wait_s, utc)
                flown = on_all_cores(f"late links: {name}", fly, [(late, seed) for seed in seeds])
                known = "host's UTC known" if utc else "no UTC"
                figures.append(_figure(f"{name}, messages wait {wait_s * 1e3:g} ms, {known}", flown))
    return figures


def fly(drawn: tuple[Late, int]) -> Flown:
    """Fly one draw: everybody turns at random, ranges from the denied vehicle only, nobody answers TIMESYNC."""
    late, seed = drawn
    flight = WanderingFlight(Scenario(mutual=False), seed, FLIGHT_S)
    vehicles = tuple(flight.courses)
    rng = np.random.default_rng([seed, 3])
    delays_s = late.delays_s(rng, vehicles)
    behind_s = dict(zip(vehicles, rng.uniform(*_UTC_BEHIND_S, len(vehicles)).tolist(), strict=True))
    engine = fresh_engine()
    engine.receive(ClockReference(0.0, _UNIX_S, late.utc))
    under_way: list[tuple[float, int, FromVehicle]] = []
    order = count()
    newest_s = dict.fromkeys(vehicles, 0.0)
    errors, bounds, distrusted = [], [], set()
    for step in range(round(FLIGHT_S / STEP_S)):
        t = step * STEP_S
        arrives_s = {v: max(t + delays_s[v] + float(rng.exponential(late.wait_s)), newest_s[v]) for v in vehicles}
        newest_s = arrives_s
        for message in (*flight.messages(t), *_system_times(step, behind_s)):
            at_s = arrives_s[message.sysid]
            heapq.heappush(under_way, (at_s, next(order), replace(message, received_at_s=at_s)))
        while under_way and under_way[0][0] <= t:
            engine.receive(heapq.heappop(under_way)[2])
        engine.poll(t)
        distrusted |= {v for v in engine.sysids() if engine.gps_state(v) in (GpsState.SUSPECT, GpsState.FAILED)}
        if t > _COUNTED_FROM_S:
            error_m, bound_m = error_and_bound_m(engine, flight, t) or (np.nan, np.nan)
            errors.append(error_m)
            bounds.append(bound_m)
    return Flown(tally(np.array(errors), np.array(bounds)), len(distrusted - {DENIED}))


def _system_times(step: int, behind_s: Mapping[int, float]) -> Iterator[SystemTime]:
    t = step * STEP_S
    if step % _UTC_EVERY_STEPS == 0:
        for vehicle, utc_behind_s in behind_s.items():
            yield SystemTime(vehicle, t, t, _UNIX_S + t - utc_behind_s)


def _figure(name: str, flown: list[Flown]) -> Figure:
    t = sum((one.stated for one in flown), start=NONE)
    beyond, far_off = 1.0 - t.covered / max(t.fixes, 1), t.far_off / max(t.fixes, 1)
    text = (
        f"a fix in {t.fixes / t.epochs:.1%}; of these beyond the bound {beyond:.1%}, beyond 3 x {far_off:.2%}; "
        f"distrusted {sum(one.distrusted for one in flown)} of {4 * len(flown)}"
    )
    return Figure("late-links", name, text, "beyond <= 7 %, beyond 3 x <= 1e-4", beyond <= 0.07 and far_off <= 1e-4)
