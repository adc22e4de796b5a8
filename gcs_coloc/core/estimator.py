"""The protocol that every estimator meets. A new estimator is one file with one class that has these members."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

from gcs_coloc.core.measurements import Estimate, Measurement, NoEstimate, Residual


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
        """Initialise the position of a denied vehicle anew at time `at_s`, without what it reported of itself before.

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
