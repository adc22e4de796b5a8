"""An estimator that fails in flight, in whatever way, stops nothing, is told of once, and its answers are never a fix."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from engine_flights import StraightLine, aids, fly, settings

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.estimator import GuardedEstimator
from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, NoEstimateReason, Residual
from gcs_coloc.core.messages.outbound import Notice


class Faulty(StraightLine):
    """Raises, or answers with what is no position."""

    name = "faulty"
    fault = "none"

    def add(self, measurement: Measurement) -> None:
        if self.fault == "add":
            raise ZeroDivisionError
        super().add(measurement)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        if self.fault == "raise":
            raise ValueError("singular")
        answer = super().estimate(vehicle, at_s)
        if self.fault == "nan" and isinstance(answer, Estimate):
            answer.position_enu_m[1] = np.nan
        if isinstance(answer, Estimate):
            match self.fault:
                case "negative":
                    answer.covariance[0, 0] = -1.0
                case "indefinite":
                    answer.covariance[0, 1] = answer.covariance[1, 0] = 2.0 * answer.covariance[0, 0]
                case "velocity indefinite":
                    answer.covariance[3, 4] = answer.covariance[4, 3] = 2.0 * np.sqrt(
                        answer.covariance[3, 3] * answer.covariance[4, 4]
                    )
                case "three indefinite":  # each two of them could be
                    for i, j, share in ((0, 1, 0.9), (1, 2, 0.9), (0, 2, -0.9)):
                        covariance = share * np.sqrt(answer.covariance[i, i] * answer.covariance[j, j])
                        answer.covariance[i, j] = answer.covariance[j, i] = covariance
                case "asymmetric":
                    answer.covariance[0, 1], answer.covariance[1, 0] = 0.1, -0.1
                case "another vehicle":
                    return replace(answer, vehicle=vehicle - 1)
                case "another time":
                    return replace(answer, at_s=at_s - 1.0)
                case "exit":
                    sys.exit(3)
                case "forgotten return":
                    return None  # type: ignore[return-value]
                case "position only":
                    return replace(answer, covariance=answer.covariance[:3, :3])
                case "flat":
                    return replace(answer, position_enu_m=answer.position_enu_m[:2])
                case "list":
                    return replace(answer, velocity_enu_mps=[0.0, 0.0, 0.0])  # type: ignore[arg-type]
                case "far of six":
                    return replace(answer, far_covariance=answer.covariance)
                case "far indefinite":
                    return replace(answer, far_covariance=np.array([[1.0, 2.0], [2.0, 1.0]]))
                case "no count":
                    return replace(answer, ranges_in_use=None)  # type: ignore[arg-type]
        return answer

    def drain_residuals(self) -> list[Residual]:
        if self.fault == "residuals":
            return None  # type: ignore[return-value]
        empty = Residual(4, 1, 0.0, 0.0, 1.0, np.nan, 0, None)
        return [empty] if self.fault == "empty residual" else super().drain_residuals()

    def counts(self) -> dict[str, int]:
        if self.fault == "counts":
            raise KeyError("used")
        return dict(super().counts())


@pytest.mark.parametrize(
    "fault",
    [
        *("raise", "nan", "negative", "indefinite", "forgotten return", "position only", "flat", "list", "no count"),
        *("far of six", "far indefinite", "velocity indefinite", "three indefinite", "asymmetric"),
        *("another vehicle", "another time", "exit"),
    ],
)
def test_a_faulty_estimator_stops_nothing_and_its_answers_are_never_a_fix(fault):
    estimator = Faulty()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    estimator.fault = fault
    out = fly(engine, 5.0, 9.0, failed=[4])
    assert len(aids(out, 4)) > 25
    assert {a.fix_type for _, a in aids(out, 4)} == {1}
    assert len([o for _, o in out if isinstance(o, Notice) and o.level == "error"]) == 1


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("residuals", "raised an exception: TypeError"),
        ("empty residual", "a residual that is none"),
        ("counts", "KeyError: 'used' (test_"),
    ],
)
def test_a_fault_beside_the_position_is_told_with_its_place_and_costs_no_fix(fault, words):
    estimator = Faulty()
    engine = Engine(estimator, settings())
    fly(engine, 0.0, 5.0)
    estimator.fault = fault
    out = fly(engine, 5.0, 9.0, failed=[4])
    assert {a.fix_type for t, a in aids(out, 4) if t > 6.5} == {3}
    assert sum(engine.snapshot(9.0).estimator_counts.values()) >= 1
    told = [o.text for _, o in [*out, *fly(engine, 9.0, 9.5, failed=[4])] if isinstance(o, Notice) and o.level == "error"]
    assert len(told) == 1
    assert words in told[0]


def test_an_estimator_that_refuses_a_measurement_is_told_of_once():
    estimator = Faulty()
    estimator.fault = "add"
    engine = Engine(estimator, settings())
    out = fly(engine, 0.0, 5.0)
    assert len([o for _, o in out if isinstance(o, Notice) and "ZeroDivisionError" in o.text]) == 1
    assert engine.snapshot(5.0).estimator_counts["raised an exception"] > 100


def test_a_reason_in_words_of_its_own_is_kept():
    class Wordy(StraightLine):
        name = "wordy"

        def estimate(self, vehicle: int, at_s: float) -> NoEstimate:
            return NoEstimate(vehicle, at_s, "its battery is flat")  # type: ignore[arg-type]

    answer = GuardedEstimator(Wordy(), print).estimate(4, 1.0)
    assert isinstance(answer, NoEstimate)
    assert (answer.reason.reason, answer.reason.text) == (NoEstimateReason.OTHER, "its battery is flat")
