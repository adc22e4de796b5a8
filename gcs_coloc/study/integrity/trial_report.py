"""The report of the trials by class: events per hour, availability, coverage, time to alert.

The rates of events have their Poisson limits.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from scipy.stats import chi2

from gcs_coloc import __version__
from gcs_coloc.runtime.files import writing
from gcs_coloc.study.integrity.flight_classes import CLASSES, Group
from gcs_coloc.study.integrity.trial import FLIGHT_S, TIME_TO_ALERT_S, EventKind, TrialScore
from gcs_coloc.study.integrity.trial_runs import RunOptions, flown_with

_CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class EventRate:
    """Events per hour: how many, and the one-sided 95 % limits of their rate if they are Poisson events."""

    count: int
    hours: float
    at_least_per_h: float
    at_most_per_h: float

    @classmethod
    def of(cls, count: int, hours: float) -> EventRate:
        """Return the rate of so many events in so many hours.

        Source: Garwood's exact limits of a Poisson mean.
        """
        if hours <= 0.0:
            return cls(count, hours, 0.0, float("inf"))
        least = float(chi2.ppf(1.0 - _CONFIDENCE, 2 * count)) / 2.0 if count else 0.0
        most = float(chi2.ppf(_CONFIDENCE, 2 * count + 2)) / 2.0
        return cls(count, hours, least / hours, most / hours)


@dataclass(frozen=True, slots=True)
class ClassResult:
    """The result of a class of flights, or of several classes.

    `rates` are those of all events, by kind; `late` counts those that lasted longer than the time to alert. Shares are of one.
    `alerts_s` are quantiles 0.5 and 1 of the time to alert, over faulty receivers that were found; `unalerted` were not.
    """

    name: str
    flights: int
    hours: float
    sound_hours: float
    rates: dict[str, EventRate]
    late: dict[str, int]
    fix_share: float
    covered_95: float | None
    rmse_m: float | None
    mean_hpl_m: float | None
    distrusted_share: float
    alerts_s: tuple[float, float] | None
    faulty: int
    unalerted: int


def class_result(name: str, scores: Sequence[TrialScore]) -> ClassResult:
    """Sum up the flights of one class, or of several under one name."""
    hours, sound_hours = sum(s.under_aid_s for s in scores) / 3600.0, sum(s.sound_s for s in scores) / 3600.0
    fix_s, hpl_s = sum(s.fix_s for s in scores), sum(s.hpl_s for s in scores)
    events = [event for score in scores for event in score.events]
    alerts = [alert for score in scores for alert in score.alerts_s]
    found = [alert for alert in alerts if alert is not None]
    return ClassResult(
        name=name,
        flights=len(scores),
        hours=hours,
        sound_hours=sound_hours,
        rates={
            kind.value: EventRate.of(
                sum(event.kind is kind for event in events), sound_hours if kind is EventKind.SOUND_FAILED else hours
            )
            for kind in EventKind
        },
        late={kind.value: sum(event.kind is kind and event.lasted_s > TIME_TO_ALERT_S for event in events) for kind in EventKind},
        fix_share=fix_s / (hours * 3600.0) if hours else 0.0,
        covered_95=sum(s.covered_s for s in scores) / fix_s if fix_s else None,
        rmse_m=sqrt(sum(s.squares_m2s for s in scores) / fix_s) if fix_s else None,
        mean_hpl_m=sum(s.hpl_m_s for s in scores) / hpl_s if hpl_s else None,
        distrusted_share=sum(s.distrusted_s for s in scores) / (sound_hours * 3600.0) if sound_hours else 0.0,
        alerts_s=(float(np.median(found)), max(found)) if found else None,
        faulty=len(alerts),
        unalerted=len(alerts) - len(found),
    )


def all_results(scores: Sequence[TrialScore]) -> list[ClassResult]:
    """Return the result of each class that was flown, then of each group, then of all."""
    rows = [class_result(name, chosen) for name in CLASSES if (chosen := [s for s in scores if s.name == name])]
    groups = {group: [s for s in scores if CLASSES[s.name].group is group] for group in Group}
    rows += [class_result(f"all {group.value}", chosen) for group, chosen in groups.items() if chosen]
    return [*rows, class_result("all", scores)]


def result_table(results: Sequence[ClassResult]) -> Table:
    """Return the results as one table.

    In a cell of events the number after the stroke counts those that lasted beyond the time to alert.
    """
    table = Table(title="Integrity trials")
    headings = ("class", "h", "fix %", "cov %", "rmse m", "> 3 b", "> HPL", "> limit", "HPL m", "sound", "FAILED",
                "dist. %", "alert s", "none")  # fmt: skip
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place else "left", no_wrap=True)
    for r in results:
        table.add_row(
            r.name,
            f"{r.hours:.2f}",
            f"{r.fix_share:.1%}"[:-1],
            "-" if r.covered_95 is None else f"{r.covered_95:.1%}"[:-1],
            _metres(r.rmse_m),
            _events(r, EventKind.BEYOND_BOUNDS),
            "-" if r.mean_hpl_m is None else _events(r, EventKind.BEYOND_HPL),
            _events(r, EventKind.BEYOND_ALERT_LIMIT),
            _metres(r.mean_hpl_m),
            f"{r.sound_hours:.2f}",
            str(r.rates[EventKind.SOUND_FAILED].count),
            f"{r.distrusted_share:.1%}"[:-1],
            "-" if r.alerts_s is None else f"{r.alerts_s[0]:.1f}, {r.alerts_s[1]:.1f}",
            f"{r.unalerted} of {r.faulty}" if r.faulty else "-",
        )
    return table


def limit_lines(results: Sequence[ClassResult]) -> list[str]:
    """Return the 95 % limits of the rates of all flights, a line for each kind of event."""
    whole = results[-1]
    lines = []
    for kind, rate in whole.rates.items():
        if kind == EventKind.BEYOND_HPL and whole.mean_hpl_m is None:
            continue
        limits = f"{rate.at_least_per_h:.3g} to {rate.at_most_per_h:.3g} per hour (each limit 95 %)"
        lines.append(f"{kind.replace('_', ' ')}: {rate.count} in {rate.hours:.1f} h, {limits}; {whole.late[kind]} beyond 6 s")
    return lines


def event_lines(scores: Sequence[TrialScore]) -> list[str]:
    """Return a line for each event, with what repeats its flight."""
    lines = []
    for score in scores:
        for e in score.events:
            size = (
                f": {e.error_m:.0f} m off at {e.bound_m:.1f} m, {e.lasted_s:.1f} s at a stretch" if e.error_m else f": {e.detail}"
            )
            where = f"{score.name} --first-seed {score.seed}, vehicle {e.sysid}, {e.from_s:.1f} to {e.until_s:.1f} s"
            lines.append(f"{e.kind.value}: {where}: {size}")
    return lines


def write_report(options: RunOptions, scores: Sequence[TrialScore], results: Sequence[ClassResult]) -> Path:
    """Write everything as JSON beside the flights.

    Raises:
        UsageError: the file cannot be written.
    """
    path = options.out / "integrity.json"
    content: dict[str, Any] = {
        "version": __version__,
        **flown_with(options.estimator),
        "flight_s": FLIGHT_S,
        "time_to_alert_s": TIME_TO_ALERT_S,
        "seeds": sorted({score.seed for score in scores}),
        "results": [asdict(result) for result in results],
        "events": [{"class": score.name, "seed": score.seed} | asdict(event) for score in scores for event in score.events],
    }
    with writing(path, ""):
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return path


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _events(result: ClassResult, kind: EventKind) -> str:
    count = result.rates[kind].count
    return f"{count} / {result.late[kind]}" if count else "0"
