"""Predicted peers: what the prediction of a loss knows of the peers and of the ranges to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray, NoEstimate, PositionMeasurement
from gcs_coloc.core.readiness.held_motion import HeldMotion
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, NoiseSplit
from gcs_coloc.estimators.fleet.ekf.update import split_report_noise, time_stamp_offset_sigma_s
from gcs_coloc.estimators.fleet.fleet_model import UNDERSTATED, FleetModel


@dataclass(slots=True)
class RangeStream:
    """The ranges of one device to one peer: their rate, stated sigma, and how many of them are used.

    `scatter_m2` is the mean square of what is seen to be white, None where they come too seldom to tell. `stamp_sigma_s` is the
    time-stamp offset that they state where the vehicle's clock stamps them, else None.
    """

    node: int
    pair: tuple[int, int, int]
    rate_hz: float
    sigma_m: float
    scatter_m2: float | None
    stamp_sigma_s: float | None
    seen: float = 0.0

    def noise_m(self, least_coloured_share: float) -> tuple[float, float]:
        """Return the white and the coloured sigma that the filter would have learned by now, m."""
        noise = NO_SAMPLES
        if self.scatter_m2 is not None:
            noise = NoiseSplit((), ((self.scatter_m2 * self.seen, self.seen),))
        scatter_m = noise.lower_bound_m(0)
        white_m = scatter_m if scatter_m > UNDERSTATED * self.sigma_m else self.sigma_m
        return white_m, noise.split(0, self.sigma_m, least_coloured_share)[1]


@dataclass(frozen=True, slots=True)
class PeerPoint:
    """A peer: how it moves from the beginning on, and the covariance of its position (3, 3) m^2.

    Its error is a Gauss-Markov process as that of position reports; that of an anchor lasts.
    """

    motion: HeldMotion
    covariance_m2: FloatArray
    is_anchor: bool = False


def peer_point(model: FleetModel, node: int, at_s: float, turn_radps: float) -> PeerPoint | None:
    """Return a peer as the filter knows it; None where it does not know where it is."""
    record = model.records.get(node)
    if record is None:
        return None
    last, s = record.last_position, model.settings
    if node in model.clusters or last is None or last.velocity_enu_mps is None or record.static:
        where = model.estimate(node, at_s)
        if isinstance(where, NoEstimate):
            return None
        (e, n, u), (ve, vn, vu) = where.position_enu_m.tolist(), where.velocity_enu_mps.tolist()
        return PeerPoint(HeldMotion((e, n, u), (ve, vn, vu), turn_radps), where.covariance[:3, :3], record.static)
    if record.denied_vehicle or at_s - last.measured_at_s > s.initialisation_age_s:
        return None
    reports = sum(isinstance(m, PositionMeasurement) for m in record.recent_own)
    white, coloured = split_report_noise(record, last, s)
    velocity = np.array(last.velocity_enu_mps)
    variances_m2 = [white[axis // 2] ** 2 / max(reports, 1) + coloured[axis // 2] ** 2 for axis in range(3)]
    covariance_m2 = np.diag(variances_m2) + time_stamp_offset_sigma_s(last, s) ** 2 * np.outer(velocity, velocity)
    reported = HeldMotion(last.position_enu_m, last.velocity_enu_mps, turn_radps)
    return PeerPoint(reported.after(at_s - last.measured_at_s), covariance_m2)
