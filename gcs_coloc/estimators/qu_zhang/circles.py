"""One slant range to a moving peer as a circle in the horizontal plane at a common time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs_coloc.core.measurements import FloatArray, RangeMeasurement, Residual
from gcs_coloc.estimators.qu_zhang.track import UNKNOWN_SPEED_SIGMA_MPS, PeerTrack


@dataclass(frozen=True, slots=True)
class Circle:
    """One range, brought to the epoch and to the horizontal plane.

    `centre_m` (2,) is the peer, shifted by what the vehicle moves between the range and the epoch; `centre_covariance` (2, 2),
    m^2, is that of the centre. `height_m` is the vehicle's height above the peer, `height_variance_m2` the peer's part of its
    variance. `lasting_covariance` (3, 3), m^2, is the part of the peer's error that stays from epoch to epoch.
    """

    peer: int
    centre_m: FloatArray
    centre_covariance: FloatArray
    range_m: float
    range_sigma_m: float
    height_m: float
    height_variance_m2: float
    lasting_covariance: FloatArray

    @property
    def squared_m2(self) -> float:
        """The squared horizontal range, m^2; noise can make that of a peer overhead negative."""
        return self.range_m**2 - self.height_m**2

    @property
    def squared_variance_m4(self) -> float:
        """Its variance from the range and the peer's height, m^4, with the second order that matters for a peer overhead."""
        return (
            4.0 * self.range_m**2 * self.range_sigma_m**2
            + 2.0 * self.range_sigma_m**4
            + 4.0 * self.height_m**2 * self.height_variance_m2
            + 2.0 * self.height_variance_m2**2
        )


def make_circle(
    peer: int, measurement: RangeMeasurement, peer_track: PeerTrack, own_track: PeerTrack, at_s: float, lasting: bool
) -> Circle:
    """Return the circle that one range puts the vehicle on at the time `at_s` of its epoch.

    The peer is taken where it was when the range was measured; the circle's centre then moves along with the vehicle's own
    predicted displacement until `at_s`, and the velocity's uncertainty over that time widens the centre's. Both tracks must have
    a vertical filter, the peer's a horizontal one too; ValueError otherwise. `lasting` is whether the peer's
    position error lasts from epoch to epoch.
    """
    if peer_track.horizontal is None or peer_track.vertical is None or own_track.vertical is None:
        raise ValueError("a circle needs the peer's position and the vehicle's height")
    then_s = measurement.measured_at_s
    peer_state, peer_covariance = peer_track.horizontal.predicted(then_s)
    peer_height, peer_height_covariance = peer_track.vertical.predicted(then_s)
    own_height, _ = own_track.vertical.predicted(then_s)
    velocity, velocity_covariance = np.zeros(2), UNKNOWN_SPEED_SIGMA_MPS**2 * np.eye(2)
    if own_track.horizontal is not None:
        own_state, own_covariance = own_track.horizontal.predicted(at_s)
        velocity, velocity_covariance = own_state[[1, 3]], own_covariance[np.ix_([1, 3], [1, 3])]
    elapsed_s = at_s - then_s
    variances = np.array([peer_track.sigma_h_m, peer_track.sigma_h_m, peer_track.sigma_v_m]) ** 2
    return Circle(
        peer=peer,
        centre_m=peer_state[[0, 2]] + velocity * elapsed_s,
        centre_covariance=peer_covariance[np.ix_([0, 2], [0, 2])] + velocity_covariance * elapsed_s**2,
        range_m=measurement.range_m,
        range_sigma_m=measurement.sigma_m,
        height_m=float(own_height[0] - peer_height[0]),
        height_variance_m2=float(peer_height_covariance[0, 0]) + (peer_track.sigma_v_m**2 if lasting else 0.0),
        lasting_covariance=np.diag(variances) if lasting else np.zeros((3, 3)),
    )


def range_residual(
    vehicle: int, circle: Circle, predicted: tuple[FloatArray, FloatArray], measured_at_s: float, refused: str | None
) -> Residual:
    """Return the residual of one range against the vehicle's predicted state (4,) and covariance (4, 4) at the epoch."""
    state, covariance = predicted
    offset = np.array([*(state[[0, 2]] - circle.centre_m), circle.height_m])
    distance_m = float(np.linalg.norm(offset))
    unit = offset / max(distance_m, 1e-9)
    spread = covariance[np.ix_([0, 2], [0, 2])] + circle.centre_covariance + circle.lasting_covariance[:2, :2]
    variance = float(unit[:2] @ spread @ unit[:2]) + unit[2] ** 2 * circle.height_variance_m2 + circle.range_sigma_m**2
    innovation_m = circle.range_m - distance_m
    return Residual(
        from_vehicle=vehicle,
        to_vehicle=circle.peer,
        measured_at_s=measured_at_s,
        innovation_m=innovation_m,
        sigma_m=math.sqrt(variance),
        nis=innovation_m**2 / variance,
        degrees_of_freedom=1,
        refused=refused,
    )
