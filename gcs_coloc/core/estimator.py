"""The protocol that every estimator meets with one class in one file, and the guard around one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import chain
from math import inf, isfinite, sqrt
from numbers import Integral
from pathlib import PurePath
from typing import Protocol

import numpy as np

from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, NoEstimateReason, RangeMeasurement, Residual, Unlocated
from gcs_coloc.core.reasons import StatedReason

_SIX_ROWS = [6] * 6
_TWO_ROWS = [2] * 2
_SAME_S = 1e-6  # chosen: of a time that was computed anew in another way
_ROUNDING = 1e-9  # of a correlation; chosen: far above what rounding makes of a covariance of six states
_ANY_FAILURE = (Exception, SystemExit)  # a plug-in may call sys.exit


class Estimator(Protocol):
    """Takes timed measurements one by one and answers where a vehicle is.

    An estimator has no clock: time comes with the measurements (`arrived_at_s` never decreases from call to call, while
    `measured_at_s` may) and with the questions. It is deterministic: the same calls give the same answers to the last bit.
    """

    @property
    def name(self) -> str:
        """The name that the configuration chooses it by."""
        ...

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        """State which vehicles are to be located from ranges from time `at_s` on.

        The estimator gets no PositionMeasurement of a denied vehicle. One that becomes denied in flight starts from its last
        trusted measurements, if these are fresh.
        """
        ...

    def reset(self, vehicle: int, at_s: float) -> None:
        """Initialise a denied vehicle anew at time `at_s`, without what it reported of itself before.

        The engine calls it when such reports have proved wrong. An estimator whose state holds none of them does nothing.
        """
        ...

    def add(self, measurement: Measurement) -> None:
        """Take one measurement. Never raises for its values: what is of no use is counted (see `counts`)."""
        ...

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer where a vehicle is at a time near the present.

        The state is predicted beyond, or stepped back to before, the newest measurement.
        """
        ...

    def drain_residuals(self) -> list[Residual]:
        """The residuals since the last call, oldest first; bounded, the oldest are lost first."""
        ...

    def counts(self) -> Mapping[str, int]:
        """How often what happened to measurements, by reason: used, refused by the gate, too late, ..."""
        ...


@dataclass(frozen=True, slots=True)
class LossQuery:
    """The question what an estimator would state of a healthy vehicle if its GPS failed now."""

    vehicle: int
    at_s: float
    """The vehicle is denied from this time on (service time, s)."""
    horizon_s: float
    """So far ahead the vehicle is predicted."""
    ranges: Sequence[RangeMeasurement]
    """The vehicle's ranges of the last seconds. They go on as they came."""
    turns_radps: Mapping[int, float] = field(default_factory=dict)
    """The turn rates of vehicles that turn, clockwise. They are held, as all speeds are."""
    height_sigma_m: float = inf
    """1-sigma of the heights that come in place of the vehicle's position reports, as often as these; infinite where none do."""


class PredictsLoss(Protocol):
    """What an estimator may offer beside `Estimator`: the prediction of a loss of GPS."""

    def predict_loss(self, query: LossQuery) -> Sequence[Estimate | NoEstimate]:
        """Predict a vehicle as if it were denied from `query.at_s` on.

        Returns the answers at that time and on, the last at the horizon.

        The estimator's own state does not change.
        """
        ...


class EstimatorFault(StrEnum):
    """What no estimator may do. The value is the wording, and the `outcome` label of the metric."""

    RAISED = "raised an exception"
    NO_RESIDUAL = "gave a residual that is none"
    NOT_A_POSITION = "gave a result that is no position with a covariance"
    NOT_ASKED_FOR = "gave the position of another vehicle or time than was asked for"


class GuardedEstimator:
    """Keeps a faulty estimator from doing harm.

    `report` is called with the text of each kind of fault once.

    Estimators are plug-ins. An exception in one must neither stop the service nor leave an aircraft with a frozen position: what
    is raised or not finite is counted, the answer is then NoEstimate, and the aid goes out with fix_type 1.
    """

    def __init__(self, inner: Estimator, report: Callable[[str], None]) -> None:
        self._inner = inner
        self._report = report
        self._faults: Counter[EstimatorFault] = Counter()

    @property
    def name(self) -> str:
        """The inner estimator's name."""
        return self._inner.name

    def set_denied(self, denied: Collection[int], at_s: float) -> None:
        """As the protocol says."""
        try:
            self._inner.set_denied(denied, at_s)
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)

    def reset(self, vehicle: int, at_s: float) -> None:
        """As the protocol says."""
        try:
            self._inner.reset(vehicle, at_s)
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)

    def add(self, measurement: Measurement) -> None:
        """As the protocol says."""
        try:
            self._inner.add(measurement)
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """As the protocol says; NoEstimate where the inner estimator fails.

        It fails also where its answer is none, or no position of that vehicle at that time with a covariance.
        """
        try:
            answer = self._inner.estimate(vehicle, at_s)
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)
            return NoEstimate(
                vehicle, at_s, Unlocated(NoEstimateReason.ESTIMATOR_FAILED, detail=f"failed: {type(error).__name__}")
            )
        if isinstance(answer, NoEstimate):
            if isinstance(answer.reason, StatedReason):
                return answer
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER, detail=str(answer.reason)))
        if not _is_sound(answer):
            return self._no_answer(vehicle, at_s, EstimatorFault.NOT_A_POSITION)
        if answer.vehicle != vehicle or not abs(answer.at_s - at_s) <= _SAME_S:
            return self._no_answer(vehicle, at_s, EstimatorFault.NOT_ASKED_FOR)
        return answer

    def predict_loss(self, query: LossQuery) -> Sequence[Estimate | NoEstimate] | None:
        """As `PredictsLoss` says; None where the inner estimator does not predict, or fails."""
        predict = getattr(self._inner, "predict_loss", None)
        if predict is None:
            return None
        try:
            answers = list(predict(query))
            is_sound = bool(answers) and all(isinstance(each, NoEstimate) or _is_sound(each) for each in answers)
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)
            return None
        if not is_sound:
            self._count(EstimatorFault.NOT_A_POSITION, None)
            return None
        return answers

    def drain_residuals(self) -> list[Residual]:
        """As the protocol says."""
        try:
            residuals = list(self._inner.drain_residuals())
            sound = [residual for residual in residuals if _is_residual(residual)]
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)
            return []
        if len(sound) != len(residuals):
            self._count(EstimatorFault.NO_RESIDUAL, None)
        return sound

    @property
    def faults(self) -> Mapping[EstimatorFault, int]:
        """How often each kind of fault occurred."""
        return dict(self._faults)

    def counts(self) -> Mapping[str, int]:
        """The inner estimator's counts and the faults."""
        try:
            counts = {str(reason): int(count) for reason, count in self._inner.counts().items()}
        except _ANY_FAILURE as error:
            self._count(EstimatorFault.RAISED, error)
            counts = {}
        return {**counts, **{fault.value: count for fault, count in self._faults.items()}}

    def _no_answer(self, vehicle: int, at_s: float, fault: EstimatorFault) -> NoEstimate:
        self._count(fault, None)
        return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.ESTIMATOR_FAILED, detail=fault.value))

    def _count(self, fault: EstimatorFault, error: BaseException | None) -> None:
        self._faults[fault] += 1
        if self._faults[fault] == 1:
            detail = f": {type(error).__name__}: {error}{_place(error)}" if error is not None else ""
            self._report(f"estimator {self.name} {fault.value}{detail}; an answer that fails is not used")


def _place(error: BaseException) -> str:
    """Where it was raised, for the author of a plug-in."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f" ({PurePath(trace.tb_frame.f_code.co_filename).name}, line {trace.tb_lineno})" if trace is not None else ""


def _is_sound(answer: object) -> bool:
    """Whether it is an Estimate of finite arrays of the right shapes, and its covariances are such."""
    if not isinstance(answer, Estimate) or not isinstance(answer.ranges_in_use, Integral):
        return False
    try:
        # As lists: for so few numbers numpy's functions take several times as long.
        position, velocity, rows = answer.position_enu_m.tolist(), answer.velocity_enu_mps.tolist(), answer.covariance.tolist()
        far = rows if answer.far_covariance is None else answer.far_covariance.tolist()
        if len(position) != 3 or len(velocity) != 3 or [len(row) for row in rows] != _SIX_ROWS:
            return False
        if far is not rows and [len(row) for row in far] != _TWO_ROWS:
            return False
        is_finite = all(map(isfinite, chain(position, velocity, *rows, *far)))
    except (AttributeError, TypeError):
        return False
    return is_finite and _is_covariance(rows) and (far is rows or _is_covariance(far))


def _is_covariance(rows: list[list[float]]) -> bool:
    """Whether finite rows are symmetric and positive definite.

    Tested on the correlations, as variances may differ by many powers of ten.
    """
    if not all(row[i] > 0.0 for i, row in enumerate(rows)):
        return False
    per_sigma = [1.0 / sqrt(row[i]) for i, row in enumerate(rows)]
    correlations = np.array(rows) * np.outer(per_sigma, per_sigma)
    if abs(correlations - correlations.T).max() > _ROUNDING or rows[0][0] * rows[1][1] <= rows[0][1] * rows[1][0]:
        return False
    try:
        np.linalg.cholesky(correlations + _ROUNDING * np.eye(len(rows)))
    except np.linalg.LinAlgError:
        return False
    return True


def _is_residual(residual: object) -> bool:
    return isinstance(residual, Residual) and residual.degrees_of_freedom > 0 and isfinite(residual.nis)
