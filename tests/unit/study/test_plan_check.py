"""The check of predictions compares like with like, and its drawn flights bear a prediction out."""

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from gcs_coloc.cli.main import app
from gcs_coloc.planning.prediction import predict
from gcs_coloc.study.drawn_flight import DrawnFlight, fly_plan
from gcs_coloc.study.plan_check import CHECK_PLANS, compare


@pytest.fixture(scope="module")
def stations():
    checked = CHECK_PLANS["stations"]()
    vehicles = tuple(replace(vehicle, end_s=60.0) for vehicle in checked.plan.vehicles)
    plan = replace(checked.plan, vehicles=vehicles)
    return plan, predict(plan, (1,))[0]


def flown(predicted, error_m, hpl_factor=1.0):
    return DrawnFlight(predicted.at_s, error_m, hpl_factor * predicted.hpl_m, predicted.has_fix)


def test_ratios_and_coverage_are_those_of_errors_of_a_known_size(stations):
    _, predicted = stations
    rng = np.random.default_rng(1)
    sigma_m = predicted.bound_95_m / 2.4477
    drawn = [flown(predicted, sigma_m * np.hypot(*rng.standard_normal((2, len(sigma_m))))) for _ in range(1000)]
    honest = compare("n", "t", predicted, drawn)
    assert honest.median_ratio == pytest.approx(1.0, abs=0.05)
    assert honest.covered == pytest.approx(0.95, abs=0.01)
    assert honest.told
    assert all(window.is_close and window.is_shown_close for window in honest.told)
    double = compare("n", "t", predicted, [replace(flight, error_m=2.0 * flight.error_m) for flight in drawn])
    assert double.median_ratio == pytest.approx(2.0, abs=0.1)
    assert not any(window.is_close or window.may_be_close for window in double.windows)


def test_few_flights_whose_errors_last_leave_it_open(stations):
    _, predicted = stations
    rng = np.random.default_rng(2)
    sigma_m = predicted.bound_95_m / 2.4477
    few = [flown(predicted, sigma_m * np.hypot(*rng.standard_normal(2))) for _ in range(20)]
    check = compare("n", "t", predicted, few)
    assert check.told
    for window in check.told:
        low, high = window.interval
        assert low <= window.ratio <= high
        assert window.may_be_close
        assert not window.is_shown_close


def test_what_has_no_bound_is_not_compared_and_counts_as_not_told(stations):
    _, predicted = stations
    bound_m = predicted.bound_95_m.copy()
    bound_m[predicted.at_s > 50.0] = np.nan
    half = compare("n", "t", replace(predicted, bound_95_m=bound_m), [flown(predicted, predicted.bound_95_m)])
    assert half.not_told >= np.mean(predicted.at_s > 50.0)
    assert max(window.from_s for window in half.windows) <= 50.0


def test_levels_and_fixes_are_compared_as_well(stations):
    _, predicted = stations
    error_m = np.where(predicted.at_s > 50.0, 1.1 * predicted.hpl_m, 0.0)
    half = replace(flown(predicted, error_m, 1.3), has_fix=(predicted.at_s < 45.0).astype(float))
    check = compare("n", "t", predicted, [half, flown(predicted, error_m, 1.3)])
    assert all(window.hpl_ratio == pytest.approx(1.3) for window in check.windows)
    settled = predicted.at_s >= predicted.at_s[0] + 20.0
    assert check.fix_predicted == 1.0
    assert check.fix_reached == pytest.approx(0.5 + 0.5 * np.mean(predicted.at_s[settled] < 45.0))
    assert check.beyond_hpl == np.sum(predicted.at_s > 50.0)  # of the flight that has a fix there


@pytest.mark.parametrize("name", ["stations", "copters"])
def test_drawn_flights_are_as_far_off_as_predicted(name):
    # Of three flights the 95 % scatters by a third (chi of some six independent errors); levels do by a tenth.
    checked = CHECK_PLANS[name]()
    plan = replace(checked.plan, vehicles=tuple(replace(vehicle, end_s=60.0) for vehicle in checked.plan.vehicles))
    predicted = predict(plan, (1,))[0]
    check = compare("n", "t", predicted, [fly_plan(plan, 1, seed) for seed in range(1, 4)])
    assert 0.5 < check.median_ratio < 1.5
    assert check.covered > 0.85
    assert check.beyond_hpl == 0
    assert check.fix_reached == check.fix_predicted == 1.0
    assert all(0.7 < window.hpl_ratio < 1.5 for window in check.windows)


def test_an_unknown_plan_is_told():
    ran = CliRunner().invoke(app, ["study", "planning", "--plan", "none"])
    assert "--plan none: there is no such plan; there are around, abreast" in str(ran.exception)
