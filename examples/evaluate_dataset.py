"""Evaluates an estimator on a data set; without arguments on one that it makes.

python examples/evaluate_dataset.py
python examples/evaluate_dataset.py my-recording fleet
python examples/evaluate_dataset.py my-recording examples/own_estimator.py:RangePull
"""

from __future__ import annotations

import sys
from math import cos, dist, sin
from pathlib import Path
from tempfile import TemporaryDirectory

from gcs_coloc import evaluate, load_estimator

ANCHORS = {"A": (0.0, 0.0, 2.0), "B": (60.0, 0.0, 3.0), "C": (0.0, 60.0, 2.0), "D": (60.0, 60.0, 4.0)}


def write_dataset(directory: Path) -> None:
    """Write a walk of a minute among four anchors, without GPS after 5 s, in the layout of docs/reference/dataset.md."""
    meta = [
        'name = "walk"\nsource = "made by evaluate_dataset.py"\nlicence = "CC0"\ndims = 3\n[[node]]\nid = "W"\nrole = "denied"'
    ]
    for name, (e, n, u) in ANCHORS.items():
        meta.append(f'[[node]]\nid = "{name}"\nrole = "anchor"\ne_m = {e}\nn_m = {n}\nu_m = {u}\nsigma_m = 0.05')
    positions, ranges, truth = (
        ["t_s,id,e_m,n_m,u_m,sigma_h_m,sigma_v_m"],
        ["t_s,from_id,to_id,range_m,sigma_m"],
        ["t_s,id,e_m,n_m,u_m"],
    )
    for i in range(301):
        t = 0.2 * i
        walker = (30.0 + 20.0 * cos(t / 15.0), 30.0 + 20.0 * sin(t / 15.0), 1.5)
        e, n, u = walker
        truth.append(f"{t:.1f},W,{e:.3f},{n:.3f},{u:.3f}")
        if t <= 5.0:
            positions.append(f"{t:.1f},W,{e:.3f},{n:.3f},{u:.3f},0.5,0.5")
        ranges += [f"{t:.1f},W,{name},{dist(walker, anchor):.3f},0.1" for name, anchor in ANCHORS.items()]
    for file, lines in (("meta.toml", meta), ("positions.csv", positions), ("ranges.csv", ranges), ("truth.csv", truth)):
        (directory / file).write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """Evaluate and print the score of each denied vehicle."""
    with TemporaryDirectory() as made:
        directory, estimator = [*sys.argv[1:], *(made, "fleet")[len(sys.argv) - 1 :]]
        if directory == made:
            write_dataset(Path(made))
        evaluation = evaluate(Path(directory), load_estimator(estimator, {}))
    for finding in evaluation.findings:
        print(f"warning: {finding.text}")
    for vehicle in evaluation.denied:
        score = vehicle.score
        error = f"horizontal RMSE {score.horizontal.rmse_m:.2f} m, ANEES {score.anees:.2f}" if score.horizontal else "no estimate"
        print(f"{evaluation.dataset}, {evaluation.estimator}, {vehicle.node.id}: {score.share_known:.0%} answered, {error}")


if __name__ == "__main__":
    main()
