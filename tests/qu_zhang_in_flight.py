"""Flies the estimator of Qu & Zhang in a simulated fleet, and asks it."""

import numpy as np
from fleet_in_flight import Fleet

from gcs_coloc.core.measurements import Estimate, Unknown
from gcs_coloc.estimators.qu_zhang import QuZhang

STEP_S = 0.2


def fly(estimator: QuZhang, fleet: Fleet, start_s: float, end_s: float, subjects: tuple[int, ...] = ()) -> None:
    estimator.set_subjects(subjects, start_s)
    for k in range(round((end_s - start_s) / STEP_S)):
        for measurement in fleet.round(start_s + k * STEP_S, subjects):
            estimator.add(measurement)


def located(estimator: QuZhang, vehicle: int, at_s: float) -> Estimate:
    answer = estimator.estimate(vehicle, at_s)
    assert isinstance(answer, Estimate), answer
    return answer


def why_unknown(estimator: QuZhang, vehicle: int, at_s: float) -> str:
    answer = estimator.estimate(vehicle, at_s)
    assert isinstance(answer, Unknown), answer
    return answer.reason


def error_m(answer: Estimate, fleet: Fleet) -> float:
    return float(np.linalg.norm(answer.position_enu_m - fleet.at(answer.vehicle, answer.at_s)))
