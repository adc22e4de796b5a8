"""What became of measurements and epochs: the closed list of outcomes that the filter counts."""

from __future__ import annotations

from enum import StrEnum


class QuZhangOutcome(StrEnum):
    """What became of a measurement or an epoch of ranges.

    The values are the keys of `counts()` and the labels of the metric.
    """

    NO_CLASS = "vehicle class not used by this estimator"
    NO_ATTITUDE = "attitude not used by this estimator"
    NO_ODOMETRY = "odometry not used by this estimator"
    REFUSED_IMPOSSIBLE = "impossible value"
    REFUSED_FUTURE = "measured in the future"
    REFUSED_TOO_LATE = "too late"
    REFUSED_DENIED_POSITION = "position of a vehicle without GPS"
    POSITION_USED = "position used"
    REFUSED_POSITION_GATE = "position refused by the gate"
    ALTITUDE_NOT_NEEDED = "altitude of a vehicle with GPS"
    ALTITUDE_USED = "altitude used"
    REFUSED_ALTITUDE_GATE = "altitude refused by the gate"
    RANGE_BOTH_GPS = "range between vehicles with GPS"
    RANGE_BOTH_DENIED = "range between vehicles without GPS"
    RANGE_PEER_NOT_FRESH = "range to a peer without a fresh position"
    FIX_USED = "fix used"
    EPOCH_WITHOUT_FIX = "epoch without a fix"
    FIX_REFUSED = "fix refused"
    RANGE_USED = "range used"
    RANGE_NOT_USED = "range not used"
