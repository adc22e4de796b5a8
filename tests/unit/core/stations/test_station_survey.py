"""The survey of a station from the ranges of vehicles with GPS: where it is, how well that is known, and what leaves it open."""

from __future__ import annotations

from itertools import pairwise
from math import cos, dist, hypot, sin

import numpy as np
import pytest

from gcs_coloc.core.measurements import PositionMeasurement, RangeMeasurement
from gcs_coloc.core.stations import station_survey
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.core.stations.station_survey import StationSurvey, SurveyProblem
from gcs_coloc.core.stations.stations import MAX_STATIONS

NODE = station_node(7)
PLACE = (420.0, -160.0, -30.0)
SIGMA_M = 0.5


def circle(t: float, climb_m: float):
    """A plane that circles with 250 m and climbs and sinks."""
    return 250.0 * cos(t / 15.0), 250.0 * sin(t / 15.0), 90.0 + climb_m * sin(t / 23.0)


def line(t: float, climb_m: float):
    return 20.0 * t - 1000.0, 100.0, 90.0 + climb_m * sin(t / 23.0)


def surveyed(seed: int, path=circle, climb_m=60.0, bias_m=0.0, outliers=0.0, gps_m=1.0, place=PLACE):
    """What a flight of 200 s tells; the receiver's error lasts for all of it."""
    rng = np.random.default_rng(seed)
    survey, told = StationSurvey(), []
    off = rng.normal(0.0, gps_m, 3)
    for k in range(1000):
        t = 0.2 * k
        where, after = path(t, climb_m), path(t + 0.01, climb_m)
        velocity = tuple((b - a) / 0.01 for a, b in zip(where, after, strict=True))
        at = tuple(float(p + e) for p, e in zip(where, off, strict=True))
        long_m = rng.uniform(5.0, 40.0) if rng.random() < outliers else 0.0
        range_m = dist(where, place) + bias_m + long_m + rng.normal(0.0, SIGMA_M)
        report = PositionMeasurement(1, t, t, at, gps_m, gps_m, velocity)
        survey.add(RangeMeasurement(1, NODE, t, t, range_m, SIGMA_M), report)
        sought = survey.solve_next()
        told += [sought[1]] if sought is not None else []
    return survey.found.get(NODE), told


def errors_m(found, place=PLACE):
    return hypot(found.enu_m[0] - place[0], found.enu_m[1] - place[1]), abs(found.enu_m[2] - place[2])


@pytest.mark.parametrize(
    ("case", "off_m", "sigma_m"),
    [
        ({}, 4.0, 2.0),
        ({"bias_m": 0.8}, 4.0, 2.0),
        ({"outliers": 0.1}, 5.0, 2.0),
        ({"place": (-2000.0, 600.0, 200.0)}, 25.0, 10.0),
    ],
    ids=["plain", "biased", "outliers", "far"],
)
def test_a_station_is_found_within_what_is_stated(case, off_m, sigma_m):
    """Of 8 flights at most two are beyond 2.45 sigmas (height: 2): with right sigmas 9 % are, and three of 8 in 3 %."""
    beyond = 0
    for seed in range(8):
        found, told = surveyed(seed, **case)
        assert found is not None
        horizontal_m, vertical_m = errors_m(found, case.get("place", PLACE))
        assert horizontal_m < off_m
        assert found.sigma_h_m < sigma_m
        sigmas = [one.sigma_h_m for one in told if not isinstance(one, SurveyProblem)]
        assert sigmas[-1] <= sigmas[0]
        beyond += horizontal_m > 2.45 * found.sigma_h_m or vertical_m > 2.0 * found.sigma_v_m
    assert beyond <= 2


@pytest.mark.parametrize("case", [{"path": line, "climb_m": 0.0}, {"climb_m": 0.0}], ids=["straight", "level"])
def test_a_side_that_the_ranges_leave_open_gives_no_position(case):
    for seed in range(4):
        found, told = surveyed(seed, **case)
        assert found is None
        assert told == [SurveyProblem.AMBIGUOUS]


def test_two_heights_no_further_apart_than_receivers_err_leave_the_side_open():
    """Copters circle at 60 and 64 m; the higher one's receiver is 6 m too low, twice what it states: above fits better."""
    survey = StationSurvey()
    rng = np.random.default_rng(1)
    for k in range(600):
        t = 0.2 * k
        for vehicle, up_m, off_m in ((1, 60.0, 0.0), (2, 64.0, -6.0)):
            angle = t / 10.0 + vehicle
            east_m, north_m = 80.0 * cos(angle), 80.0 * sin(angle)
            velocity = (-8.0 * sin(angle), 8.0 * cos(angle), 0.0)
            report = PositionMeasurement(vehicle, t, t, (east_m, north_m, up_m + off_m), 3.0, 3.0, velocity)
            range_m = dist((east_m, north_m, up_m), (20.0, 10.0, 0.0)) + rng.normal(0.0, 0.1)
            survey.add(RangeMeasurement(vehicle, NODE, t, t, range_m, 0.1), report)
        survey.solve_next()
        assert not survey.found


def test_a_station_far_off_to_one_side_is_told_as_coarse_and_each_reason_once():
    """Later in the flight its height is known well enough to tell two places apart, for a while."""
    found, told = surveyed(1, place=(20_000.0, 0.0, 0.0))
    assert found is None
    assert told == [SurveyProblem.COARSE, SurveyProblem.AMBIGUOUS]


def test_a_survey_is_told_again_only_when_it_is_known_twice_as_well():
    _, told = surveyed(3)
    sigmas = [max(one.sigma_h_m, one.sigma_v_m) for one in told if not isinstance(one, SurveyProblem)]
    assert 1 <= len(sigmas) <= 5
    assert all(later <= 0.5 * before for before, later in pairwise(sigmas))


def test_a_vehicle_that_hovers_adds_nothing():
    survey = StationSurvey()
    for k in range(500):
        report = PositionMeasurement(1, 0.2 * k, 0.2 * k, (0.0, 0.0, 50.0), 1.0, 1.0, (0.0, 0.0, 0.0))
        survey.add(RangeMeasurement(1, NODE, 0.2 * k, 0.2 * k, 100.0, SIGMA_M), report)
        assert survey.solve_next() is None
    assert survey.found == {}


def test_forged_stations_fill_no_more_than_a_table_and_one_is_sought_at_a_time():
    survey = StationSurvey()
    for k in range(40):
        at = circle(3.0 * k, 60.0)
        report = PositionMeasurement(1, k, k, at, 0.1, 0.1, (0.0, 0.0, 0.0))
        for station in range(MAX_STATIONS + 40):
            survey.add(RangeMeasurement(1, station_node(station), k, k, dist(at, PLACE), 0.1), report)
    for sought in range(MAX_STATIONS + 40):
        assert len(survey.found) == min(sought, MAX_STATIONS)
        survey.solve_next()


def test_the_ranges_that_are_kept_stay_spread_over_the_whole_flight(monkeypatch):
    kept = []
    monkeypatch.setattr(station_survey, "survey_position", lambda samples: kept.append(samples) or SurveyProblem.COARSE)
    survey = StationSurvey()
    for k in range(1000):
        report = PositionMeasurement(1, k, k, (20.0 * k, 0.0, 90.0), 1.0, 1.0, (20.0, 0.0, 0.0))
        survey.add(RangeMeasurement(1, NODE, k, k, 500.0, SIGMA_M), report)
    survey.solve_next()
    numbers = [sample.position_m[0] / 20.0 for sample in kept[-1]]
    # 30 are expected of each quarter, with a sigma of 4.4.
    assert np.histogram(numbers, bins=4, range=(0.0, 1000.0))[0] == pytest.approx([30] * 4, abs=18)
    assert len(numbers) == 120


def drawn_survey(seed: int):
    """Random flights of one to three vehicles, their receivers' lasting errors, and up to a quarter of the ranges blocked."""
    rng = np.random.default_rng(seed)
    place = rng.uniform((-300.0, -300.0, -5.0), (300.0, 300.0, 10.0))
    sigma_m, gps_m, blocked = rng.choice([0.1, 0.3, 1.0, 3.0]), rng.choice([0.8, 1.5, 3.0]), rng.choice([0.0, 0.1, 0.25])
    bias_m, climb_m, vehicles = 0.5 * rng.normal(), rng.choice([0.0, 20.0, 80.0]), int(rng.integers(1, 4))
    survey = StationSurvey()
    for vehicle in range(1, vehicles + 1):
        centre, radius_m, height_m = rng.uniform(-300.0, 300.0, 2), rng.uniform(50.0, 400.0), rng.uniform(20.0, 120.0)
        angle, lasting_m, wander_m = rng.uniform(0.0, 6.28), 0.7 * gps_m * rng.normal(size=3), np.zeros(3)
        for k in range(180 // vehicles):
            angle += 12.0 / radius_m
            where = np.array([*(centre + radius_m * np.array([cos(angle), sin(angle)])), height_m + climb_m * sin(2.0 * angle)])
            wander_m = 0.97 * wander_m + 0.17 * gps_m * rng.normal(size=3)
            long_m = rng.exponential(8.0) if rng.random() < blocked else 0.0
            range_m = float(np.linalg.norm(where - place)) + bias_m + long_m + sigma_m * rng.normal()
            at, stated_m = tuple((where + lasting_m + wander_m).tolist()), 1.5 * gps_m
            report = PositionMeasurement(vehicle, float(k), float(k), at, stated_m, stated_m, (0.0, 0.0, 0.0))
            survey.add(RangeMeasurement(vehicle, NODE, float(k), float(k), range_m, sigma_m), report)
    survey.solve_next()
    return survey.found.get(NODE), place


def test_no_drawn_survey_states_a_wrong_place():
    """Of those found none is beyond five sigmas in height or six horizontally: with right sigmas one in a million.

    Among these draws are level flights whose wandering heights once told above from beneath, wrongly. Of 600 draws 60 % are
    found: of 80 fewer than 30 once in 10,000.
    """
    found = 0
    for seed in range(240, 320):
        survey, place = drawn_survey(seed)
        if survey is not None:
            found += 1
            horizontal_m, vertical_m = errors_m(survey, place)
            assert horizontal_m < 6.0 * survey.sigma_h_m
            assert vertical_m < 5.0 * survey.sigma_v_m
    assert found > 30
