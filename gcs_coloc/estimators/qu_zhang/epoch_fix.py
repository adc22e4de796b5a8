"""From the ranges of one epoch to a fix under the settings of the paper's stack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gcs_coloc.core.measurements import FloatArray
from gcs_coloc.estimators.qu_zhang.circles import Circle, make_circle
from gcs_coloc.estimators.qu_zhang.epochs import RangeEpoch
from gcs_coloc.estimators.qu_zhang.fix import Fix, published_covariance, solve
from gcs_coloc.estimators.qu_zhang.gating import threshold
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings
from gcs_coloc.estimators.qu_zhang.track import PeerTrack


def circles_of(
    epoch: RangeEpoch, own: PeerTrack, peers: Mapping[int, PeerTrack], at_s: float, settings: QuZhangSettings
) -> tuple[list[Circle], list[str]]:
    """Return the circles of the epoch's ranges at the time `at_s`, and in words why ranges are not usable.

    `peers` are the tracks of the vehicles that may serve as peers. Without a height of its own the vehicle has no circle.
    """
    circles, reasons = [], []
    for peer, measurement in sorted(epoch.ranges.items()):
        track = peers.get(peer)
        if track is None or track.position_age_s(measurement.measured_at_s) > settings.peer_age_limit_s:
            reasons.append(f"vehicle {peer} has no fresh position")
        elif own.vertical is not None:
            circles.append(make_circle(peer, measurement, track, own, at_s, settings.lasting_peer_errors))
    return circles, reasons


def fix_of(
    vehicle: int,
    own: PeerTrack,
    circles: list[Circle],
    predicted: tuple[FloatArray, FloatArray] | None,
    at_s: float,
    settings: QuZhangSettings,
) -> Fix | str:
    """Return the fix with the covariance that the settings choose, or the reason in words why there is none.

    `predicted` is where the vehicle's filter expects it, position (2,) and covariance (2, 2), None where it has none.
    """
    if own.vertical is None:
        return "no height of its own"
    fix = solve(
        vehicle,
        circles,
        predicted,
        float(own.vertical.predicted(at_s)[1][0, 0]) + own.sigma_v_m**2,
        min_flatness=settings.min_flatness,
        nis_limit=threshold(settings.gate_probability, 1),
    )
    if isinstance(fix, str):
        return fix
    if not settings.lasting_peer_errors:
        fix = replace(fix, sensitivities={}, lasting={})
    if settings.covariance == "constant":
        return replace(fix, covariance=settings.constant_sigma_m**2 * np.eye(2))
    if settings.covariance == "published":
        published = published_covariance(fix, circles, None if predicted is None else predicted[0])
        if not np.isfinite(published).all():
            return "two peers are seen in one direction"
        return replace(fix, covariance=published)
    return fix
