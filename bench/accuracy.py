"""How good the fleet filter is: the figures E1 to E7 of docs/explanation/accuracy.md, and its peers beside it.

All with the estimator's default settings. Seeds are 1, 2, ... and their number stands in the name of each figure.
"""

from __future__ import annotations

from collections.abc import Callable

from bench import accuracy_recordings
from bench.accuracy_flights import Case, Links, Recording, record
from bench.accuracy_model import ModelCase, bounds_rms_m, draw, recording
from bench.accuracy_peers import FilterpyEkf, FilterpyUkf, installed
from bench.accuracy_runs import (
    Locator,
    Run,
    Track,
    anees,
    band_95,
    beyond_6_sigma,
    fleet_through,
    on_all_cores,
    relative_error_of_mse,
    rmse_m,
    run_estimator,
    unknown_share,
)
from bench.figures import Figure
from gcs_coloc.estimators.registry import load_estimator

_DENIED = 4
_MODEL_CASES = (ModelCase(50.0, 5.0, 8.0, 20.0), ModelCase(5.0, 15.0, 20.0, 50.0))
_PLAIN = Case()
_AIDED = Case(wind_east_mps=8.0, air_data=True)
# Asked 0.2 s back, as much as telemetry lags behind: both, so that the one thing compared is the links.
_CLEAN = Case(rate_hz=5.0, ask_lag_s=0.2)
_DIRTY = Case(rate_hz=5.0, ask_lag_s=0.2, links=Links())
_TWO = Case(rate_hz=5.0, failed=(4, 5), fifth=True)
_TWO_APART = Case(rate_hz=5.0, failed=(4, 5), fifth=True, mutual=False)
_PEERS = ("fleet", "filterpy EKF", "filterpy UKF", "Stone Soup EKF", "GTSAM smoother")


def measure(quick: bool) -> list[Figure]:
    """Run all of it; what is not reached says so."""
    return [
        *(figure for case in _MODEL_CASES for figure in _own_model(case, 16 if quick else 200)),
        *_paper_flight("E2 paper's flight, 50 Hz", _PLAIN, 1 if quick else 20, 13.0, 5.5, "range-fed CV EKF 15.8 / 6.0"),
        *_paper_flight("E3 with air data, wind 8 m/s", _AIDED, 1 if quick else 10, 7.0, None, "bound about 5.7"),
        *_telemetry(2 if quick else 20),
        *_two_failed(2 if quick else 20),
        *accuracy_recordings.measure_ranges(),
        *accuracy_recordings.measure_replay(),
        *_peers(5.0, 1 if quick else 4),
        *([] if quick else _peers(50.0, 2)),
    ]


def _figure(name: str, value: str, goal: str = "", reached: bool | None = None) -> Figure:
    return Figure(name, value, goal, reached)


def _own_model(case: ModelCase, runs: int) -> list[Figure]:
    draws = draw(case, runs, seed=1)
    posterior_m, along_m = bounds_rms_m(draws)
    done = on_all_cores("E1", _fleet_over, [recording(draws, run) for run in range(runs)])
    tracks = [run.tracks[_DENIED] for run in done]
    error_m, mean = rmse_m(tracks), anees(tracks)
    ratio, ratio_along = (error_m / posterior_m) ** 2, (error_m / along_m) ** 2
    scatter = ratio_along * relative_error_of_mse(tracks)
    low, high = band_95(runs)
    name = f"E1 own model, {case.rate_hz:g} Hz, {runs} runs"
    lost = unknown_share(tracks)
    return [
        _figure(
            f"{name}, MSE / posterior bound",
            f"{ratio:.2f} ({error_m:.2f} m / {posterior_m:.2f} m)",
            "<= 1.05",
            ratio <= 1.05 and lost == 0.0,
        ),
        _figure(f"{name}, MSE / mean bound along each flight", f"{ratio_along:.2f} +- {scatter:.2f} (bound {along_m:.2f} m)"),
        _figure(f"{name}, ANEES", f"{mean:.2f} of 2", f"{low:.2f} to {high:.2f}", low <= mean <= high),
    ]


def _fleet_over(one: Recording) -> Run:
    return run_estimator(one, load_estimator("fleet", {}))


def _flown(what: str, case: Case, seeds: int) -> list[Run]:
    return on_all_cores(what, fleet_through, [(case, seed) for seed in range(1, seeds + 1)])


def _honesty(name: str, tracks: list[Track]) -> Figure:
    """Not overconfident: the mean over runs and epochs lies below the upper end of the band."""
    low, high = band_95(len(tracks))
    mean = anees(tracks)
    text = f"{mean:.2f} of 2, beyond 6 sigma {beyond_6_sigma(tracks):.1e}, unknown {unknown_share(tracks):.1%}"
    return _figure(f"{name}, ANEES", text, f"<= {high:.2f} (band {low:.2f} to {high:.2f})", mean <= high)


def _paper_flight(what: str, case: Case, seeds: int, goal_m: float, first_goal_m: float | None, reference: str) -> list[Figure]:
    done = _flown(what, case, seeds)
    tracks = [run.tracks[_DENIED] for run in done]
    name = f"{what}, {seeds} seeds"
    whole_m, first_m = rmse_m(tracks), rmse_m(tracks, 100.0)
    known = unknown_share(tracks) == 0.0
    figures = [_figure(f"{name}, RMSE", f"{whole_m:.2f} m", f"<= {goal_m} m ({reference})", whole_m <= goal_m and known)]
    goal = f"<= {first_goal_m} m" if first_goal_m is not None else ""
    reached = first_m <= first_goal_m and known if first_goal_m is not None else None
    return [*figures, _figure(f"{name}, RMSE of the first 100 s", f"{first_m:.2f} m", goal, reached), _honesty(name, tracks)]


def _telemetry(seeds: int) -> list[Figure]:
    clean, dirty = (
        [run.tracks[_DENIED] for run in _flown(f"E4 {what}", case, seeds)]
        for what, case in (("clean", _CLEAN), ("as it comes", _DIRTY))
    )
    name = f"E4 paper's flight as telemetry, 5 Hz, {seeds} seeds"
    ratio = rmse_m(dirty) / rmse_m(clean)
    wrong = beyond_6_sigma(dirty)
    return [
        _figure(f"{name}, RMSE / clean", f"{ratio:.2f} ({rmse_m(dirty):.1f} m / {rmse_m(clean):.1f} m)", "<= 1.3", ratio <= 1.3),
        _figure(
            f"{name}, error beyond 6 sigma", f"{wrong:.1e} of epochs (clean {beyond_6_sigma(clean):.1e})", "< 1e-4", wrong < 1e-4
        ),
        _honesty(name, dirty),
    ]


def _two_failed(seeds: int) -> list[Figure]:
    together, apart = _flown("E6 together", _TWO, seeds), _flown("E6 apart", _TWO_APART, seeds)
    figures = []
    for vehicle in _TWO.failed:
        name = f"E6 two of five denied, 5 Hz, {seeds} seeds, vehicle {vehicle}"
        with_m, without_m = (rmse_m([run.tracks[vehicle] for run in done]) for done in (together, apart))
        text = f"{with_m:.2f} m, without the other's ranges {without_m:.2f} m"
        figures.append(_figure(f"{name}, RMSE", text, "smaller than without", with_m < without_m))
        figures.append(_honesty(name, [run.tracks[vehicle] for run in together]))
    return figures


def _peers(rate_hz: float, seeds: int) -> list[Figure]:
    tasks = [(peer, rate_hz, seed) for peer in _PEERS if _maker(peer) is not None for seed in range(1, seeds + 1)]
    runs: dict[str, list[Run]] = {}
    for (peer, _, _), run in zip(tasks, on_all_cores("peers", _peer_through, tasks), strict=True):
        runs.setdefault(peer, []).append(run)
    figures = []
    for peer in _PEERS:
        name = f"same ranges, {rate_hz:g} Hz, {seeds} seeds: {peer}"
        if peer not in runs:
            figures.append(_figure(name, "not installed"))
            continue
        tracks = [run.tracks[_DENIED] for run in runs[peer]]
        cpu_us = sum(run.cpu_us for run in runs[peer]) / seeds
        text = f"{rmse_m(tracks):.2f} m, first 100 s {rmse_m(tracks, 100.0):.2f} m, ANEES {anees(tracks):.2f}, {cpu_us:.0f} us"
        figures.append(_figure(name, text))
    return figures


def _peer_through(task: tuple[str, float, int]) -> Run:
    peer, rate_hz, seed = task
    make = _maker(peer)
    assert make is not None
    return run_estimator(record(Case(rate_hz=rate_hz), seed), make())


def _maker(peer: str) -> Callable[[], Locator] | None:
    """Return what makes a peer, None where it is not installed: those of the extra `bench` are imported only here."""
    if peer == "fleet":
        return lambda: load_estimator("fleet", {})
    if peer == "filterpy EKF":
        return FilterpyEkf
    if peer == "filterpy UKF":
        return FilterpyUkf
    if peer == "Stone Soup EKF" and installed("stonesoup"):
        from bench.accuracy_stonesoup import StoneSoupEkf

        return StoneSoupEkf
    if peer == "GTSAM smoother" and installed("gtsam"):
        from bench.accuracy_gtsam import GtsamSmoother

        return GtsamSmoother
    return None
