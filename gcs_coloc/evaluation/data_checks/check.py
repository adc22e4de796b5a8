"""All that can be said against a recording from itself."""

from __future__ import annotations

from gcs_coloc.evaluation.data_checks.clocks import check_clocks
from gcs_coloc.evaluation.data_checks.distances import check_distances
from gcs_coloc.evaluation.data_checks.evidence import Evidence
from gcs_coloc.evaluation.data_checks.finding import DataFinding
from gcs_coloc.evaluation.data_checks.positions import check_heights, check_truth, check_velocities
from gcs_coloc.evaluation.data_checks.rows import check_repeats


def run_checks(evidence: Evidence) -> list[DataFinding]:
    """Return what does not agree, the most basic first. Nothing is mended: an estimator is given the data as they stand."""
    of_truth = list(check_truth(evidence))
    return [
        *check_clocks(evidence),
        *of_truth,
        # A truth that is wrong beside the reports says nothing of the ranges.
        *check_distances(evidence, trust_truth=not of_truth),
        *check_heights(evidence),
        *check_velocities(evidence),
        *check_repeats(evidence),
    ]
