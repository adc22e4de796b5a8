"""One position fix from the ranges of one epoch, with its covariance.

Three peers are chosen, their ranges trilaterated, and the result is tested.

Dilution of precision (DOP) is how the peers' geometry turns range errors into position errors. With unit vectors u_i from peer i
to the vehicle as its rows, the design matrix G has the cofactor matrix (G'G)^-1. HDOP is the root of the sum over east and north
on its diagonal: metres of 1-sigma position error per metre of 1-sigma range error. Source: Qu & Zhang, section II.A.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gcs_coloc.core.measurements import FloatArray, RangeMeasurement
from gcs_coloc.core.stations.node_id import is_station, node_name
from gcs_coloc.estimators.qu_zhang import trilateration
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings
from gcs_coloc.estimators.qu_zhang.track import PeerTrack, threshold
from gcs_coloc.estimators.qu_zhang.trilateration import Circle, make_circle

_CANDIDATES = 8  # among more peers the tightest eight are tried: 56 triples, and nothing to gain from the others

_HEIGHT_TO_SIGMA = 5.0
"""A triangle of peers is a triangle only if its height stands out of the peers' own uncertainty; below, the first-order
covariance is no longer that of the fix."""


@dataclass(frozen=True, slots=True)
class Fix:
    """A position fix and what is known of its error.

    `position_m` (2,), `covariance` (2, 2) m^2 of what is new in every epoch. For each vehicle whose lasting error enters the fix,
    `sensitivities` gives how (2, k), and `lasting` its covariance (k, k), m^2: k = 3 (east, north, up) for a peer, 1 (up) for the
    vehicle itself.
    """

    peers: tuple[int, ...]
    position_m: FloatArray
    covariance: FloatArray
    hdop: float
    sensitivities: dict[int, FloatArray]
    lasting: dict[int, FloatArray]


def solve(
    vehicle: int,
    circles: list[Circle],
    predicted: tuple[FloatArray, FloatArray] | None,
    height_variance_m2: float,
    *,
    min_flatness: float,
    nis_limit: float,
) -> Fix | str:
    """Return the fix from three peers, or the reason in words why there is none.

    Of more than three, those three are taken whose fix most of the other ranges support, of these the ones that agree with the
    prediction, of these the ones of least covariance. Where ranges contradict each other and nothing tells which is wrong,
    there is no fix.

    `predicted` is where the vehicle is expected, position (2,) and covariance (2, 2): there the ranges are linearised, without it
    each three at their own fix. `height_variance_m2` is of the vehicle's own height, which all circles share. `min_flatness` is
    the least that `flatness` of the peers may be, `nis_limit` the largest NIS of circles that meet in a point.
    """
    if len(circles) < 3:
        return f"ranges to {len(circles)} of the 3 peers that a fix needs"
    candidates = sorted(circles, key=lambda one: (one.squared_variance_m4, one.peer))[:_CANDIDATES]
    triples = np.array(list(combinations(range(len(candidates)), 3)))
    centres = np.array([one.centre_m for one in candidates])[triples]
    covariances = np.array([one.centre_covariance + one.lasting_covariance[:2, :2] for one in candidates])[triples]
    largest_sigma = np.sqrt(np.trace(covariances, axis1=-2, axis2=-1).max(axis=-1))
    well_shaped = (trilateration.flatness(centres) >= min_flatness) & (
        trilateration.triangle_height_m(centres) >= _HEIGHT_TO_SIGMA * largest_sigma
    )
    if not well_shaped.any():
        return "the peers are nearly in one line"
    triples, centres, covariances = triples[well_shaped], centres[well_shaped], covariances[well_shaped]

    squared = np.array([one.squared_m2 for one in candidates])[triples]
    heights = np.array([one.height_m for one in candidates])[triples]
    own_variances = np.array([one.squared_variance_m4 for one in candidates])[triples]
    own_height = 4.0 * height_variance_m2 * heights[:, :, np.newaxis] * heights[:, np.newaxis, :] + 2.0 * height_variance_m2**2
    range_covariance = own_variances[:, :, np.newaxis] * np.eye(3) + own_height
    fixes = trilateration.trilaterate(centres, squared)
    at = fixes if predicted is None else np.broadcast_to(predicted[0], fixes.shape)
    fix_covariances = trilateration.corrected_covariance(centres, at, range_covariance, covariances)

    spread = trilateration.misclosure_covariance(centres, fixes, range_covariance, covariances)
    left_over, variance = trilateration.misclosure(centres, squared, fixes, spread)
    misclosure_nis = left_over**2 / variance
    meet = misclosure_nis <= nis_limit
    if not meet.any():
        return f"the ranges do not meet in one point (NIS {misclosure_nis.min():.0f})"
    supporters = _supporters(candidates, fixes[meet], fix_covariances[meet], height_variance_m2, nis_limit)
    chosen = _most_supported(fixes[meet], fix_covariances[meet], supporters, predicted, nis_limit)
    if chosen is None:
        return "the ranges contradict each other"
    index = np.flatnonzero(meet)[chosen]
    return _fix(
        vehicle, [candidates[i] for i in triples[index]], fixes[index], at[index], range_covariance[index], height_variance_m2
    )


def _supporters(
    candidates: list[Circle], fixes: FloatArray, fix_covariances: FloatArray, height_variance_m2: float, nis_limit: float
) -> FloatArray:
    """Return how many circles go through each fix, shape (N,), of fixes (N, 2), covariances (N, 2, 2)."""
    offsets = fixes[:, np.newaxis] - np.array([one.centre_m for one in candidates])
    residual = np.array([one.squared_m2 for one in candidates]) - (offsets**2).sum(axis=-1)
    centre = np.array([one.centre_covariance + one.lasting_covariance[:2, :2] for one in candidates])
    own = np.array([one.squared_variance_m4 + 4.0 * height_variance_m2 * one.height_m**2 for one in candidates])
    spread = fix_covariances[:, np.newaxis] + centre
    variance = own + 2.0 * height_variance_m2**2 + 4.0 * np.einsum("nci,ncij,ncj->nc", offsets, spread, offsets)
    return np.asarray((residual**2 <= nis_limit * variance).sum(axis=1), dtype=np.float64)


def _most_supported(
    fixes: FloatArray,
    covariances: FloatArray,
    supporters: FloatArray,
    predicted: tuple[FloatArray, FloatArray] | None,
    nis_limit: float,
) -> int | None:
    """Return the index of the chosen fix among those that most circles support.

    Of N fixes, the shapes are (N, 2), (N, 2, 2) and (N,). None means that the best supported ones exclude each other.
    """
    best = np.flatnonzero(supporters == supporters.max())
    if predicted is not None:
        agree = _distance_nis(fixes[best] - predicted[0], covariances[best] + predicted[1]) <= 2.0 * nis_limit
        best = best[agree] if agree.any() else best
    chosen = int(best[np.argmin(np.trace(covariances[best], axis1=-2, axis2=-1))])
    apart = _distance_nis(fixes[best] - fixes[chosen], covariances[best] + covariances[chosen])
    return chosen if (apart <= 2.0 * nis_limit).all() else None


def _distance_nis(differences: FloatArray, covariances: FloatArray) -> FloatArray:
    return np.asarray((differences * np.linalg.solve(covariances, differences[..., np.newaxis])[..., 0]).sum(axis=-1))


def published_covariance(fix: Fix, circles: list[Circle], predicted_m: FloatArray | None) -> FloatArray:
    """Return the paper's covariance (2, 2), m^2 (Eq. 23-26), with s_i^2 of the peers' filters alone."""
    chosen = [one for one in circles if one.peer in fix.peers]
    at = fix.position_m if predicted_m is None else predicted_m
    centres = np.array([one.centre_m for one in chosen])
    units = (at - centres) / np.linalg.norm(at - centres, axis=-1, keepdims=True)
    variances = np.array([u @ one.centre_covariance @ u for u, one in zip(units, chosen, strict=True)])
    return trilateration.published_covariance(centres, at, variances)


def _fix(
    vehicle: int,
    chosen: list[Circle],
    fix_m: FloatArray,
    at_m: FloatArray,
    range_covariance: FloatArray,
    height_variance_m2: float,
) -> Fix:
    centres = np.array([one.centre_m for one in chosen])
    heights = np.array([one.height_m for one in chosen])
    offsets = np.column_stack([at_m - centres, heights])
    # A squared range error of 1 m^2 moves the fix by a gain; a peer's error of delta is one of 2 (offset)' delta, and the
    # vehicle's own height enters all three with the opposite sign.
    gains = trilateration.gains(centres)
    sensitivities = {one.peer: np.outer(gains[:, i], 2.0 * offsets[i]) for i, one in enumerate(chosen)}
    sensitivities[vehicle] = gains @ (-2.0 * heights)[:, np.newaxis]
    lasting = {one.peer: one.lasting_covariance for one in chosen}
    lasting[vehicle] = np.array([[height_variance_m2]])
    white = np.array([one.centre_covariance for one in chosen])
    return Fix(
        peers=tuple(one.peer for one in chosen),
        position_m=fix_m,
        covariance=trilateration.corrected_covariance(centres, at_m, range_covariance, white),
        hdop=_hdop(offsets / np.linalg.norm(offsets, axis=-1, keepdims=True)),
        sensitivities=sensitivities,
        lasting=lasting,
    )


def circles_of(
    ranges: Mapping[int, RangeMeasurement], own: PeerTrack, peers: Mapping[int, PeerTrack], at_s: float, settings: QuZhangSettings
) -> tuple[list[Circle], list[str]]:
    """Return the circles of an epoch's ranges by peer at `at_s`, and why others are unusable.

    The reasons are in words. `peers` are the tracks of the vehicles that may serve as peers. Without a height of its own the
    vehicle has no circle.
    """
    circles, reasons = [], []
    for peer, measurement in sorted(ranges.items()):
        track = peers.get(peer)
        if track is None or track.position_age_s(measurement.measured_at_s) > settings.peer_age_limit_s:
            reasons.append(f"{node_name(peer) if is_station(peer) else f'vehicle {peer}'} has no fresh position")
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
    """Return the fix with the covariance that the settings choose, or why there is none, in words.

    `predicted` is where the vehicle's filter expects it, position (2,) and covariance (2, 2), None where it has none.
    """
    if own.vertical is None:
        return "no height of its own"
    fix = solve(
        vehicle,
        circles,
        predicted,
        own.height_variance_m2(at_s),
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


def _hdop(units: FloatArray) -> float:
    """Return the HDOP of three ranges without a clock bias, by unit vectors (3, 3) from the peers.

    Only east and north count: a peer seen steeply above or below adds little. That is as (G'G)^-1 by the singular values of G.
    """
    _, singular_values, vt = np.linalg.svd(units[:, :2], full_matrices=False)
    return float(np.sqrt((vt**2 / singular_values[:, np.newaxis] ** 2).sum(axis=-2).sum(axis=-1)))
