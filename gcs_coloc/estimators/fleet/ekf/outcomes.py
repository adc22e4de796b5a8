"""Outcomes: what became of a measurement, in a closed list that the filter counts."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from gcs_coloc.core.measurements import Vector3


class Outcome(StrEnum):
    """What became of one measurement. The values are the keys of `counts()` and the labels of the metric."""

    USED = "used"
    """It corrected the state."""
    INITIALISED = "used for initialisation"
    """It was the last range that multilateration needed."""
    DENIED_CHANGED = "denied vehicles changed"
    """Not a measurement: the set of denied vehicles changed."""
    CLASS_REPORTED = "vehicle class reported"
    """Not a measurement: the class of a vehicle."""
    REINITIALISED = "peer re-initialised: its reports moved away"
    """Position reports outside the gate one after another: the peer starts anew from this one."""
    KEPT_NO_STATE = "kept: vehicle has no state"
    """Its vehicle has no state now; a later initialisation uses it."""
    KEPT_NOT_DENIED = "kept: neither vehicle is denied"
    """Neither end is denied."""
    KEPT_NOT_SELECTED = "kept: other peers are selected"
    """The peer selection uses other peers."""
    KEPT_INITIALISING = "kept: waiting for initialisation"
    """The denied vehicle has no position yet; multilateration collects ranges."""
    KEPT_OPEN_SIDE = "kept: the peer may be elsewhere"
    """The denied vehicle is searched, and on which side of its own peers the other end is, is open: it locates nobody."""
    SEARCHING = "used: several places fit"
    """The denied vehicle is too uncertain to linearise its ranges; its search uses them."""
    USED_TILT = "used: tilt of a multirotor"
    """Without airspeed it tells the acceleration of a multirotor."""
    KEPT_NO_AIRSPEED = "kept: attitude without airspeed"
    """Without airspeed, or banked too steeply, an attitude says nothing of the velocity; nor does the tilt of a multirotor soon
    after another."""
    REFUSED_IMPOSSIBLE = "refused: impossible value"
    """A value is not finite, a sigma not positive, a range negative, or both ends of a range the same vehicle."""
    REFUSED_TOO_LATE = "refused: too late"
    """It arrived more than `window_s` after it was measured."""
    REFUSED_FUTURE = "refused: measured in the future"
    """Its time stamp is more than `ahead_s` after its arrival."""
    REFUSED_DUPLICATE = "refused: duplicate"
    """The same measurement is in the out-of-sequence buffer already."""
    REFUSED_DENIED_POSITION = "refused: position of a denied vehicle"
    """A denied vehicle's position reports are what the filter replaces."""
    REFUSED_POSITION_GATE = "refused: position report outside the gate"
    """Its NIS is beyond the gate, eq. (17), with all its noise and a hard manoeuvre allowed for."""
    REFUSED_RANGE_GATE = "refused: range outside the gate"
    """Its NIS is beyond the gate, eq. (17)."""
    REFUSED_AIR_GATE = "refused: air data outside the gate"
    """Their NIS is beyond the gate, eq. (17)."""
    REFUSED_AIR_DATA = "refused: air data contradict the way over ground"
    """No wind and no errors explain the difference, or none did until now and no turn has shown that they are small."""
    REFUSED_SAME_PLACE = "refused: both ends estimated at one place"
    """The range has no direction."""
    REFUSED_PEER_WITHOUT_POSITION = "refused: peer without a position"
    """The peer has no position report to start from."""


class UpdateResult(NamedTuple):
    """The outcome of one measurement, with the innovation, its sigma and NIS where there was a test.

    `unit` is the direction of a range that was used or refused by the gate.
    """

    outcome: Outcome
    innovation_m: float = 0.0
    sigma_m: float = 0.0
    nis: float = 0.0
    degrees_of_freedom: int = 0
    unit: Vector3 = (0.0, 0.0, 0.0)

    @property
    def used(self) -> bool:
        """Whether the state was corrected."""
        return self.outcome is Outcome.USED
