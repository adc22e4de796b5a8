"""Flies the estimator of Qu & Zhang in a simulated fleet, and asks it."""

import numpy as np
from fleet_in_flight import Fleet

from gcs_coloc.core.measurements import Estimate, NoEstimate
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter

STEP_S = 0.2


def fly(estimator: QuZhangFilter, fleet: Fleet, start_s: float, end_s: float, denied: tuple[int, ...] = ()) -> None:
    estimator.set_denied(denied, start_s)
    for k in range(round((end_s - start_s) / STEP_S)):
        for measurement in fleet.round(start_s + k * STEP_S, denied):
            estimator.add(measurement)


def located(estimator: QuZhangFilter, vehicle: int, at_s: float) -> Estimate:
    answer = estimator.estimate(vehicle, at_s)
    assert isinstance(answer, Estimate), answer
    return answer


def why_unknown(estimator: QuZhangFilter, vehicle: int, at_s: float) -> str:
    answer = estimator.estimate(vehicle, at_s)
    assert isinstance(answer, NoEstimate), answer
    return answer.reason.text


def error_m(answer: Estimate, fleet: Fleet) -> float:
    return float(np.linalg.norm(answer.position_enu_m - fleet.at(answer.vehicle, answer.at_s)))
