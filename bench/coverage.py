"""How often the 95 % horizontal bound holds the error, over mixed flights: wherever a fix would be stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot

import numpy as np

from bench.accuracy_flights import Case, Links
from bench.accuracy_runs import Track, fleet_through, on_all_cores
from bench.figures import Figure
from bench.integrity_flights import LOST_AT_S, STEP_S, Flight, Scenario, error_and_bound_m, fly_step, fresh_engine
from bench.wandering import WanderingFlight
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.measurements import FloatArray

_FLEET_FLIGHT_S = 300.0
_TURNING_FLIGHT_S = 240.0
_SETTLED_S = 10.0
_CLEAN = Case(rate_hz=5.0, ask_lag_s=0.2)
_TELEMETRY = Case(rate_hz=5.0, ask_lag_s=0.2, links=Links())
_TWO_FAILED = Case(rate_hz=5.0, failed=(4, 5), fifth=True)


@dataclass(frozen=True, slots=True)
class Tally:
    """Epochs asked for, those with a fix, and of these the ones within the bound and beyond three times it."""

    epochs: int
    fixes: int
    covered: int
    far_off: int

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.epochs + other.epochs, self.fixes + other.fixes, self.covered + other.covered, self.far_off + other.far_off
        )


NONE = Tally(0, 0, 0, 0)


def tally(error_m: FloatArray, bound_m: FloatArray) -> Tally:
    """Count horizontal errors (T,) against bounds (T,), NaN where no position was stated; beyond the alert limit is no fix."""
    fix = bound_m <= AidingSettings().alert_limit_m
    error, bound = error_m[fix], bound_m[fix]
    return Tally(len(bound_m), int(fix.sum()), int((error <= bound).sum()), int((error > 3.0 * bound).sum()))


def measure(quick: bool) -> list[Figure]:
    """Coverage for each kind of flight, and for all together."""
    # The epochs of one flight hang together: 1 to 2 thousand each, so that the full run has over a million.
    kinds: tuple[tuple[str, Callable[[int], Tally], int, int], ...] = (
        ("paper's flight, 5 Hz", clean_flight, 6, 180),
        ("paper's flight, 50 Hz", fast_flight, 1, 20),
        ("paper's flight as telemetry (E4)", telemetry_flight, 6, 180),
        ("two of five without GPS", two_failed_flight, 3, 60),
        ("fleets of 4 to 9 drawn at random", fleet_flight, 12, 120),
        ("two peers, all turning at random", two_peers_flight, 6, 60),
    )
    figures, total = [], NONE
    for name, fly, few, many in kinds:
        seeds = range(1, (few if quick else many) + 1)
        counted = sum(on_all_cores(f"coverage: {name}", fly, list(seeds)), start=NONE)
        figures.append(_figure(f"{name}, {len(seeds)} seeds", counted))
        total += counted
    return [*figures, _figure("all", total)]


def clean_flight(seed: int) -> Tally:
    """The paper's flight at 5 Hz, clean and synchronous."""
    return _of_case(_CLEAN, seed)


def fast_flight(seed: int) -> Tally:
    """The paper's flight at 50 Hz."""
    return _of_case(Case(), seed)


def telemetry_flight(seed: int) -> Tally:
    """The paper's flight as telemetry over poor links."""
    return _of_case(_TELEMETRY, seed)


def two_failed_flight(seed: int) -> Tally:
    """Two of five vehicles without GPS."""
    return _of_case(_TWO_FAILED, seed)


def fleet_flight(seed: int) -> Tally:
    """Five minutes of a fleet whose size, noise, courses and ranging are drawn, through the whole engine."""
    return _through_engine(Flight(drawn_scenario(seed), seed), _FLEET_FLIGHT_S)


def two_peers_flight(seed: int) -> Tally:
    """Four minutes with ranges to two peers only, without attitude, all turning at up to 45 degrees of bank; the whole engine."""
    return _through_engine(WanderingFlight(Scenario(peers=2, mutual=False), seed, _TURNING_FLIGHT_S), _TURNING_FLIGHT_S)


def _through_engine(flight: Flight, duration_s: float) -> Tally:
    engine = fresh_engine()
    errors, bounds = [], []
    for step in range(round(duration_s / STEP_S)):
        t = step * STEP_S
        fly_step(engine, flight, t)
        if t > LOST_AT_S + _SETTLED_S:
            error_m, bound_m = error_and_bound_m(engine, flight, t) or (np.nan, np.nan)
            errors.append(error_m)
            bounds.append(bound_m)
    return tally(np.array(errors), np.array(bounds))


def drawn_scenario(seed: int) -> Scenario:
    """A healthy fleet: peers, noises, courses and who ranges whom from the seed."""
    rng = np.random.default_rng([seed, 1])
    slowest_mps = rng.uniform(5.0, 20.0)
    tightest_m = rng.uniform(40.0, 600.0)
    return Scenario(
        peers=int(rng.integers(3, 9)),
        mutual=bool(rng.integers(2)),
        gps_sigma_m=float(rng.uniform(0.5, 3.0)),
        gps_time_s=float(rng.uniform(20.0, 100.0)),
        gps_white_share=float(rng.uniform(0.0, 1.0)),
        range_sigma_m=float(rng.uniform(0.3, 5.0)),
        late_share=float(rng.choice((0.0, 0.1))),
        radius_m=(tightest_m, 2.0 * tightest_m),
        speed_mps=(slowest_mps, 1.5 * slowest_mps),
        extent_m=float(rng.uniform(100.0, 1500.0)),
    )


def _of_case(case: Case, seed: int) -> Tally:
    return sum((_of_track(track) for track in fleet_through((case, seed)).tracks.values()), start=NONE)


def _of_track(track: Track) -> Tally:
    return tally(np.array([hypot(*error) for error in track.error_m]), track.bound_m)


def _figure(name: str, t: Tally) -> Figure:
    covered, far_off = t.covered / max(t.fixes, 1), t.far_off / max(t.fixes, 1)
    return Figure(
        "coverage",
        f"95 % bound, {name}",
        f"covers {covered:.1%}, error beyond 3 x {far_off:.1e}, of {t.fixes:,} fixes in {t.epochs:,} epochs",
        "93-98 %, <= 1e-4",
        0.93 <= covered <= 0.98 and far_off <= 1e-4,
    )
