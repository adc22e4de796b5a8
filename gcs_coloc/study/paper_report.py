"""The paper study in words and files: Table 2 beside the published figures, CSV, JSON and the figures."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from gcs_coloc import __version__
from gcs_coloc.core.errors import UsageError
from gcs_coloc.study.paper import FLEET, FilterScore, PaperStudy, Row
from gcs_coloc.study.paper_figures import draw_figures

TITLES = {
    "general": "general KF",
    "published": "proposed, to the letter",
    "published_with_range_noise": "proposed, with range noise",
    "corrected": "corrected covariance",
    FLEET: "fleet filter",
}
"""What each filter is called in print."""


def tables(study: PaperStudy) -> list[Table]:
    """Return Table 2 for the whole flight and for its first part, and the scores behind it, to be printed by rich."""
    first_s = study.options.first_part_s
    return [
        _table_2(study, f"Table 2: variance of UAV4's distance error, m², whole flight; {study.options.seeds} draws", whole=True),
        _table_2(study, f"the same over the first {first_s:g} s, before the peers come into one line", whole=False),
        _scores(study),
    ]


def readings(study: PaperStudy) -> dict[str, object]:
    """Return the options that the study was run with: every reading that the paper leaves open."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(study.options).items()}


def write(study: PaperStudy, out_dir: Path) -> list[Path]:
    """Write `table2.csv`, `study.json` and the figures into a directory, which is made; return the files written.

    Raises:
        UsageError: the directory or a file cannot be written, or matplotlib is not installed.

    """
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
        files = [_write_csv(study, out_dir / "table2.csv"), _write_json(study, out_dir / "study.json")]
        return [*files, *draw_figures(study, TITLES, out_dir)]
    except OSError as error:
        raise UsageError(f"{out_dir}: cannot be written: {error}") from error


def _table_2(study: PaperStudy, title: str, *, whole: bool) -> Table:
    table = Table(title=title)
    for heading in ("q", "general KF, published", "proposed, published", *(TITLES[kind] for kind in _kinds(study))):
        table.add_column(heading, justify="right")
    for q in study.options.qs:
        cells = {row.filter: row for row in study.rows if row.q in (q, None)}
        printed = [_number(cells[kind].published_variance_m2) for kind in ("general", "published")]
        variances = [(cells[kind].whole if whole else cells[kind].first).variance_m2 for kind in _kinds(study)]
        table.add_row(f"{q:g}", *printed, *(_number(variance) for variance in variances))
    return table


def _scores(study: PaperStudy) -> Table:
    first_s = study.options.first_part_s
    table = Table(title="RMSE and honesty (mean NEES of two coordinates: 2 is honest, more is overconfident)")
    table.add_column("filter")
    for heading in ("q", "draws", "RMSE, m", "largest, m", "NEES", f"RMSE to {first_s:g} s, m", f"NEES to {first_s:g} s"):
        table.add_column(heading, justify="right")
    for row in study.rows:
        whole, first = row.whole, row.first
        numbers = (whole.rmse_m, whole.largest_m, whole.anees, first.rmse_m, first.anees)
        table.add_row(TITLES[row.filter], "" if row.q is None else f"{row.q:g}", str(row.draws), *map(_number, numbers))
    return table


def _kinds(study: PaperStudy) -> list[str]:
    return list(dict.fromkeys(row.filter for row in study.rows))


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if abs(value) >= 1e4 else f"{value:.1f}"


def _write_csv(study: PaperStudy, path: Path) -> Path:
    parts = ("variance_m2", "rmse_m", "largest_m", "anees")
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        whole, first = [f"whole_{part}" for part in parts], [f"first_{part}" for part in parts]
        writer.writerow(["filter", "q", "draws", "published_variance_m2", *whole, *first])
        for row in study.rows:
            blank = ["" if value is None else value for value in (row.q, row.draws, row.published_variance_m2)]
            scores = [getattr(score, part) for score in (row.whole, row.first) for part in parts]
            writer.writerow([row.filter, *blank, *scores])
    return path


def _write_json(study: PaperStudy, path: Path) -> Path:
    constant = {f"{q:g}": R.tolist() for q, R in zip(study.options.qs, study.constant_r_m2, strict=True)}
    content = {
        "version": __version__,
        "readings": readings(study),
        "constant_r_m2_by_q": constant,
        "rows": [_row(row) for row in study.rows],
    }
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    return path


def _row(row: Row) -> dict[str, object]:
    flat = asdict(row)
    return {**flat, "whole": _score(row.whole), "first": _score(row.first)}


def _score(score: FilterScore) -> dict[str, float | None]:
    # JSON has no NaN: a filter that never answered has no score.
    return {name: value if math.isfinite(value) else None for name, value in asdict(score).items()}
