"""`gcs-coloc evaluate`: an estimator on a data set, scored."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from gcs_coloc.cli.recordings import EstimatorOption, FleetOption, settings_for, warn_of_findings
from gcs_coloc.core.estimator import GuardedEstimator
from gcs_coloc.estimators.registry import load_estimator

_MOST_REASONS = 3


def evaluate(
    directory: Annotated[Path, typer.Argument(help="A data set: meta.toml, positions.csv, ranges.csv, ...", metavar="DIR")],
    estimator: EstimatorOption = None,
    config: Annotated[Path | None, typer.Option(help="A configuration file (TOML) for the estimator and its settings.")] = None,
    fleet: FleetOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the scores as JSON.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw track, error against 2-sigma, and NIS into this file.")] = None,
) -> None:
    """Run an estimator over a data set, causally, and score it against the truth."""
    from gcs_coloc.evaluation import evaluate as study
    from gcs_coloc.evaluation.evaluate import plot_evaluation

    settings = settings_for(config, fleet, estimator)
    # As in flight: what it fails at is told and scored as no answer.
    guarded = GuardedEstimator(
        load_estimator(settings.estimator.name, settings.estimator.settings), lambda text: print(text, file=sys.stderr)
    )
    evaluation = study.evaluate(directory, guarded)
    warn_of_findings(directory, evaluation.findings)
    if plot is not None:
        plot_evaluation(evaluation, plot)
    if as_json:
        print(json.dumps(evaluation.as_dict(), indent=2))
        return
    cost = f"{evaluation.cpu_us_per_measurement:.0f} us of CPU per measurement"
    print(f"{evaluation.dataset}: estimator {evaluation.estimator}, {evaluation.measurements} measurements, {cost}")
    for denied_vehicle in evaluation.denied:
        s = denied_vehicle.score
        print(f"{denied_vehicle.node.id}: {s.epochs} true positions, {s.share_known:.1%} answered", end="")
        if s.horizontal is None or s.spatial is None or s.anees is None or s.covered_95 is None:
            print()
            _print_unanswered(denied_vehicle.unanswered)
            continue
        print(f", the first after {s.first_known_s:.1f} s")
        for name, e in (("horizontal", s.horizontal), ("3D", s.spatial)):
            print(f"  {name:<10} RMSE {e.rmse_m:.2f} m, median {e.median_m:.2f} m, 95 % {e.p95_m:.2f} m, most {e.max_m:.2f} m")
        _print_unanswered(denied_vehicle.unanswered)
        print(f"  ANEES {s.anees:.2f} ({s.anees_expected} expected), 95 % bound covers {s.covered_95:.1%}")
    counts = ", ".join(f"{what} {times}" for what, times in sorted(evaluation.counts.items(), key=lambda item: -item[1]))
    if counts:
        print(f"measurements: {counts}")


def _print_unanswered(reasons: Mapping[str, int]) -> None:
    for reason, times in list(reasons.items())[:_MOST_REASONS]:
        print(f"  not answered {times} times: {reason}{' (the first time)' if times > 1 else ''}")
