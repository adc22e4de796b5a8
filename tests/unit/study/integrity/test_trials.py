"""The judge of the trials: it sees what is false, counts it right, and a run goes on where it was stopped."""

import json
from dataclasses import replace
from math import inf

import numpy as np
import pytest
from typer.testing import CliRunner

from gcs_coloc.cli.main import app
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.errors import DataError, UsageError
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.study.integrity import trial, trial_runs
from gcs_coloc.study.integrity.trial import EventKind, TrialEvent, TrialScore, fly_trial, write_trace
from gcs_coloc.study.integrity.trial_report import EventRate, all_results, class_result, event_lines, limit_lines
from gcs_coloc.study.integrity.trial_runs import RunOptions, run_trials

LOST_AND_AIDED_S = 45.0
"""The plane of class planes, seed 2, loses its GPS after 27 s: so long it would be aided for three times the time to alert."""


def test_a_nominal_flight_is_located_and_repeats_itself():
    first, again = (fly_trial("planes", 2, duration_s=LOST_AND_AIDED_S) for _ in range(2))
    assert first == again
    assert first.fix_s > 0.95 * first.under_aid_s > 0.0
    assert first.covered_s > 0.8 * first.fix_s
    assert first.events == []
    assert first.sound_s > 100.0


@pytest.mark.parametrize(("name", "seed"), [("range-bias", 1), ("late-ranges", 5), ("height", 1)])
def test_where_all_sensors_are_worse_than_they_state_nobody_is_failed_and_the_vehicle_is_located(name, seed):
    score = fly_trial(name, seed, duration_s=60.0)
    assert score.distrusted_s == 0.0
    assert score.events == []
    assert score.fix_s > 0.9 * score.under_aid_s > 0.0


def test_an_attitude_that_is_only_repeated_lets_no_position_run_away_while_no_range_comes():
    """Taken for a fresh one it was 132 m off at a protection level of 40 m."""
    score = fly_trial("frozen-attitude", 3, duration_s=82.0)
    assert score.events == []
    assert score.fix_s > 0.6 * score.under_aid_s > 0.0


class Displaced:
    """An estimator that is sure of a place 80 m east of the right one."""

    def __init__(self, true):
        self._true = true

    def __getattr__(self, name):
        return getattr(self._true, name)

    def estimate(self, vehicle, at_s):
        where = self._true.estimate(vehicle, at_s)
        if not isinstance(where, Estimate):
            return where
        return replace(where, position_enu_m=where.position_enu_m + np.array((80.0, 0.0, 0.0)))


def test_a_wrong_position_stated_with_confidence_is_seen(monkeypatch):
    # The protection level would withhold these positions, as the ranges contradict them.
    lax = EngineSettings(request_streams=False, aiding=AidingSettings(alert_limit_m=1000.0))
    monkeypatch.setattr(trial, "EngineSettings", lambda request_streams: lax)
    monkeypatch.setattr(trial, "load_estimator", lambda name, settings: Displaced(load_estimator(name, settings)))
    score = fly_trial("planes", 2, duration_s=LOST_AND_AIDED_S)
    kinds = {event.kind for event in score.events}
    assert {EventKind.BEYOND_BOUNDS, EventKind.BEYOND_ALERT_LIMIT} <= kinds
    worst = max(score.events, key=lambda event: event.error_m)
    assert worst.error_m == pytest.approx(80.0, abs=15.0)
    assert worst.lasted_s > trial.TIME_TO_ALERT_S


class Failing(Displaced):
    """An estimator that raises an exception whenever it is asked."""

    def estimate(self, vehicle, at_s):
        raise ArithmeticError("no answer")


def test_an_estimator_that_fails_is_an_event(monkeypatch):
    """What it raises is caught for the aircraft's sake, so that its vehicles only seem to have no fix."""
    monkeypatch.setattr(trial, "load_estimator", lambda name, settings: Failing(load_estimator(name, settings)))
    score = fly_trial("planes", 2, duration_s=LOST_AND_AIDED_S)
    failed = [event for event in score.events if event.kind is EventKind.ESTIMATOR_FAILED]
    assert len(failed) == 1
    assert failed[0].detail.startswith("raised an exception")
    assert score.under_aid_s > 0.0 == score.fix_s


def test_time_to_alert_counts_from_the_fault():
    score = fly_trial("own-step", 1, duration_s=60.0)
    assert len(score.alerts_s) == 1
    assert score.alerts_s[0] is None or 0.0 < score.alerts_s[0] < 30.0


@pytest.mark.parametrize(
    ("events", "hours", "least", "most"),
    [(0, 1.0, 0.0, 2.996), (5, 10.0, 0.197, 1.051), (1, 2.0, 0.0256, 2.372), (0, 0.0, 0.0, inf)],
)
def test_limits_of_a_rate_are_those_of_the_poisson_distribution(events, hours, least, most):
    # Source: Garwood (1936), tables of the Poisson mean's limits at 95 %.
    rate = EventRate.of(events, hours)
    assert (rate.at_least_per_h, rate.at_most_per_h) == pytest.approx((least, most), rel=2e-3)


def score_of(name, seed, **values):
    return TrialScore(name, seed, under_aid_s=1800.0, fix_s=900.0, covered_s=855.0, squares_m2s=3600.0, sound_s=7200.0, **values)


def test_flights_of_a_class_add_up():
    late = TrialEvent(EventKind.BEYOND_BOUNDS, 100, 50.0, 60.0, 40.0, 9.0, lasted_s=8.0)
    short = TrialEvent(EventKind.BEYOND_BOUNDS, 100, 90.0, 91.0, 30.0, 9.0, lasted_s=1.0)
    scores = [score_of("planes", 1, events=[late]), score_of("planes", 2, events=[short], alerts_s=[2.0, None])]
    result = class_result("planes", scores)
    assert (result.hours, result.sound_hours, result.fix_share, result.covered_95, result.rmse_m) == (1.0, 4.0, 0.5, 0.95, 2.0)
    assert (result.rates["beyond_bounds"].count, result.late["beyond_bounds"]) == (2, 1)
    assert (result.alerts_s, result.faulty, result.unalerted) == ((2.0, 2.0), 2, 1)
    assert [row.name for row in all_results(scores)] == ["planes", "all nominal", "all"]
    assert "planes --first-seed 2" in event_lines(scores)[1]
    assert limit_lines(all_results(scores))[0].startswith("beyond bounds: 2 in 1.0 h")


@pytest.fixture
def flown(monkeypatch):
    seen = []

    def fly(name, seed, estimator):
        seen.append((name, seed))
        return score_of(name, seed, events=[TrialEvent(EventKind.SOUND_FAILED, 1, 3.0, 3.0, 0.0, 0.0, detail="why")])

    monkeypatch.setattr(trial_runs, "fly_trial", fly)
    return seen


def test_a_run_goes_on_where_it_was_stopped(flown, tmp_path):
    options = RunOptions(tmp_path, ("planes", "copters"), seeds=2)
    first = run_trials(replace(options, seeds=1), lambda _: None)
    assert flown == [("planes", 1), ("copters", 1)]
    done = []
    both = run_trials(options, done.append)
    assert flown[2:] == [("planes", 2), ("copters", 2)]
    assert [(s.name, s.seed) for s in both] == [("planes", 1), ("planes", 2), ("copters", 1), ("copters", 2)]
    assert both[0] == first[0]
    assert len(done) == 4


def test_a_line_that_was_cut_off_is_flown_again(flown, tmp_path):
    options = RunOptions(tmp_path, ("planes",), seeds=2)
    run_trials(options, lambda _: None)
    file = tmp_path / "flights.jsonl"
    file.write_text(file.read_text()[:-30])
    assert len(run_trials(options, lambda _: None)) == 2
    assert flown == [("planes", 1), ("planes", 2), ("planes", 2)]
    assert len(run_trials(options, lambda _: None)) == 2
    assert len(flown) == 3


def test_a_header_that_was_cut_off_is_written_again(flown, tmp_path):
    options = RunOptions(tmp_path, ("planes",), seeds=1)
    file = tmp_path / "flights.jsonl"
    run_trials(options, lambda _: None)
    whole = file.read_text()
    file.write_text(whole[:30])
    assert len(run_trials(options, lambda _: None)) == 1
    assert file.read_text() == whole
    assert len(run_trials(options, lambda _: None)) == 1
    assert len(flown) == 2


def test_hours_end_the_run(flown, tmp_path):
    scores = run_trials(RunOptions(tmp_path, ("planes", "copters"), hours=1.2), lambda _: None)
    assert sum(score.under_aid_s for score in scores) == 3 * 1800.0


def test_flights_of_another_state_of_the_program_are_refused(flown, tmp_path, monkeypatch):
    run_trials(RunOptions(tmp_path, ("planes",), seeds=1), lambda _: None)
    plug_in = tmp_path / "mine.py"
    plug_in.write_text("from gcs_coloc.estimators.fleet.filter import FleetFilter as Mine\n")
    options = RunOptions(tmp_path / "of-plug-in", ("planes",), seeds=1, estimator=f"{plug_in}:Mine")
    assert run_trials(options, lambda _: None) == run_trials(options, lambda _: None)
    plug_in.write_text(f"{plug_in.read_text()}# edited\n")
    with pytest.raises(DataError, match="another --out"):
        run_trials(options, lambda _: None)
    monkeypatch.setattr(trial_runs, "program_digest", lambda: "another")
    with pytest.raises(DataError, match="another --out"):
        run_trials(RunOptions(tmp_path, ("planes",), seeds=1), lambda _: None)


@pytest.mark.parametrize(
    "wrong", [{"classes": ("plane",), "seeds": 1}, {"seeds": 0}, {"hours": -1.0}, {}, {"seeds": 1, "hours": 1.0}]
)
def test_options_without_a_run_are_refused(wrong, tmp_path):
    with pytest.raises(UsageError):
        RunOptions(tmp_path, **wrong)


def test_the_command_writes_json_and_names_what_repeats_an_event(flown, tmp_path):
    flags = ["--class", "planes", "--seeds", "1", "--jobs", "1", "--out", str(tmp_path)]
    ran = CliRunner().invoke(app, ["study", "integrity", *flags])
    assert ran.exit_code == 0, ran.output
    assert "sound_failed: planes --first-seed 1, vehicle 1" in ran.output
    content = json.loads((tmp_path / "integrity.json").read_text())
    assert [row["name"] for row in content["results"]] == ["planes", "all nominal", "all"]
    assert content["events"][0]["class"] == "planes"


def test_the_command_lists_its_classes():
    ran = CliRunner().invoke(app, ["study", "integrity", "--list"])
    assert ran.exit_code == 0
    assert "two-alike-step" in ran.output


def test_a_trace_holds_every_sample(tmp_path, monkeypatch):
    monkeypatch.setattr(trial, "fly_trial", lambda name, seed, estimator, trace: fly_trial(name, seed, estimator, trace, 20.0))
    write_trace("planes", 1, "fleet", tmp_path / "trace.csv")
    header, *rows = (tmp_path / "trace.csv").read_text().splitlines()
    assert header.startswith("at_s,sysid,gps_state,reason,has_fix")
    assert len(rows) > 400
