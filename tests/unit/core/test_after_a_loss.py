"""What is stated of a multirotor in the first moments after its loss, while few ranges have shown how it moves."""

from __future__ import annotations

from gcs_coloc.core.measurements import Estimate
from tests.ready_fleet import RANGED, Flying, ReadyFleet

LOST_S = 20.0
EAST_AND_WEST = {RANGED: Flying((0.0, 0.0, 50.0))} | {
    2 + k: Flying((east, 60.0 * k, 50.0 + 10.0 * k)) for k, east in enumerate((-500.0, -300.0, 300.0, 500.0))
}


def test_the_last_report_of_a_trusted_vehicle_shows_its_motion_after_the_loss():
    """Messages once a second, and one range with the last of them: alone it leaves 536 m open a second later, along no range."""
    fleet = ReadyFleet(EAST_AND_WEST, winged=False, every=5)
    fleet.fly(LOST_S)
    fleet.fix_types[RANGED], ranged = 1, fleet.ranged
    fleet.ranged = ranged[:1]
    fleet.fly(LOST_S + 0.2)
    fleet.ranged = ranged
    levels_m = []
    while fleet.t < LOST_S + 4.0:
        fleet.fly(fleet.t + 0.2)
        where = fleet.engine.estimate(RANGED, fleet.t)
        assert isinstance(where, Estimate)
        assert where.protection is not None
        levels_m.append(where.protection.horizontal_m)
    # Its last report is 2.2 s old when the next ranges come, in which 1 g makes 24 m; the level of all else is 26 m.
    assert max(levels_m) <= 26.0 + 24.0
