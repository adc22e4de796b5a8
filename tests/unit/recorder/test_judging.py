from dataclasses import replace

import pytest

from gcs_coloc.recorder.judged_flight import Figures, JudgedFlight
from gcs_coloc.recorder.judging import ChangeOutcome, Tolerance, compare

BEFORE: Figures = {
    "without_gps_s": 60.0,
    "located": 1.0,
    "with_fix": 0.9,
    "bound_95_m": 2.0,
    "hpl_m": 15.0,
    "rmse_m": 1.0,
    "p95_m": 2.0,
    "most_m": 3.0,
    "covered_95": 0.97,
    "beyond_three_bounds": 0.0,
    "beyond_hpl": 0.0,
    "alarm_gps_lost": 1.0,
}


def flight(figures: Figures, name: str = "year/a.tlog") -> JudgedFlight:
    return JudgedFlight(name, "digest", 100.0, True, {"4": figures})


def outcomes(**now: float | None) -> dict[str, ChangeOutcome]:
    changes = compare([flight(BEFORE)], [flight(BEFORE | now)], Tolerance(), ["year"])
    return {change.text: change.outcome for change in changes}


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        ({}, {}),
        ({"rmse_m": 1.049, "hpl_m": 15.7, "covered_95": 0.9651}, {}),
        ({"rmse_m": 1.1}, {"horizontal RMSE, m": ChangeOutcome.WORSE}),
        ({"rmse_m": 0.5}, {"horizontal RMSE, m": ChangeOutcome.BETTER}),
        ({"rmse_m": None}, {"horizontal RMSE, m": ChangeOutcome.WORSE}),
        ({"most_m": 4.0}, {"largest error, m": ChangeOutcome.WORSE}),
        ({"covered_95": 0.96}, {"within the 95 % bound": ChangeOutcome.WORSE}),
        ({"covered_95": 0.98}, {"within the 95 % bound": ChangeOutcome.BETTER}),
        ({"beyond_hpl": 0.01}, {"beyond the protection level": ChangeOutcome.WORSE}),
        ({"with_fix": 0.8}, {"sent a fix": ChangeOutcome.WORSE}),
        ({"hpl_m": 17.0}, {"median protection level, m": ChangeOutcome.WORSE}),
        ({"without_gps_s": 90.0}, {"GPS not trusted, s": ChangeOutcome.CHANGED}),
        ({"alarm_gps_lost": 3.0}, {"alarms: gps lost": ChangeOutcome.WORSE}),
        ({"alarm_gps_suspect": 1.0}, {"alarms: gps suspect": ChangeOutcome.WORSE}),
        # What was warned of is passed over now.
        ({"alarm_gps_lost": None}, {"alarms: gps lost": ChangeOutcome.WORSE}),
    ],
)
def test_a_change_has_an_outcome(now: dict[str, float | None], expected: dict[str, ChangeOutcome]) -> None:
    assert outcomes(**now) == expected


def test_the_tolerance_is_the_callers() -> None:
    before, now = [flight(BEFORE)], [flight(BEFORE | {"rmse_m": 1.2, "covered_95": 0.9})]
    assert compare(before, now, Tolerance(relative=0.3, share=0.1), ["year"]) == []
    assert len(compare(before, now, Tolerance(), ["year"])) == 2


def test_recordings_that_came_changed_went_or_broke_are_told() -> None:
    a, b, c, d = (flight(BEFORE, f"year/{name}.tlog") for name in "abcd")
    elsewhere = flight(BEFORE, "other/a.tlog")
    broken = JudgedFlight("year/d.tlog", "digest", error="no tlog")

    changes = compare([b, c, d, elsewhere], [a, replace(b, digest="other"), broken], Tolerance(), ["year"])

    assert [(change.recording, change.outcome) for change in changes] == [
        ("year/a.tlog", ChangeOutcome.CHANGED),
        ("year/b.tlog", ChangeOutcome.CHANGED),
        ("year/d.tlog", ChangeOutcome.WORSE),
        ("year/c.tlog", ChangeOutcome.WORSE),
    ]
    assert "can no longer be read: no tlog" in changes[2].text
    assert compare([broken], [d], Tolerance(), ["year"])[0].outcome is ChangeOutcome.BETTER
    assert compare([broken], [broken], Tolerance(), ["year"]) == []


def test_a_vehicle_that_is_heard_no_more_is_worse() -> None:
    changes = compare([flight(BEFORE)], [replace(flight(BEFORE), vehicles={})], Tolerance(), ["year"])
    assert {change.outcome for change in changes} == {ChangeOutcome.WORSE, ChangeOutcome.CHANGED}
