"""Hot standby: how long an aircraft is without GPS_INPUT after the active service was killed, and whether two ever feed it."""

from __future__ import annotations

import random
import tempfile
import time
from pathlib import Path

from bench.figures import Figure
from bench.two_links import COMPONENT_IDS, DENIED, Pair, changes, two_links

_GOAL_S = 0.5
_WARM_S = 8.0
"""A service that is started needs so long to locate a vehicle without GPS from its ranges."""
_GIVE_UP_S = 20.0


def measure(quick: bool) -> list[Figure]:
    """Kill the active one in mid-aid at a random time, start it again as the standby, and kill the other one next."""
    kills, draw = 5 if quick else 20, random.Random(1)
    with two_links() as (air, ports), tempfile.TemporaryDirectory() as directory:
        pair = Pair(air, ports, Path(directory), "--no-web", "--log-level", "error")
        try:
            pair.start(0)
            pair.start(1)
            air.fly(_WARM_S)
            air.lose_gps()
            if not air.fly(_GIVE_UP_S, lambda: air.has_fix_from(COMPONENT_IDS[0])):
                raise RuntimeError(f"vehicle {DENIED} was never aided: {pair.end()}")
            began_s, taken = time.monotonic(), 0
            for kill in range(kills):
                active = kill % 2
                air.fly(_WARM_S + draw.uniform(0.0, 1.0))
                process = pair.processes[active]
                assert process is not None
                process.kill()
                process.wait()
                killed_s, other = time.monotonic(), COMPONENT_IDS[1 - active]
                taken += air.fly(_GIVE_UP_S, lambda since_s=killed_s, compid=other: air.has_fix_from(compid, since_s))  # type: ignore[misc]
                pair.start(active, role="standby")
            air.fly(2.0)
        finally:
            pair.end()
        fixes = [fed for fed in air.aids(began_s) if fed.fix_type >= 3]
        found = changes(air.aids(began_s))
    gaps_s = sorted(after.at_s - before.at_s for before, after in changes(fixes))
    within = sum(gap_s <= _GOAL_S for gap_s in gaps_s)
    all_of_them = ", ".join(f"{gap_s:.2f}" for gap_s in gaps_s)
    median_s, text = gaps_s[len(gaps_s) // 2], f"{within} of {kills} within {_GOAL_S} s"
    return [
        Figure(
            f"{kills} times kill -9 of the active service: gap in GPS_INPUT",
            f"{median_s:.2f} s (median), {gaps_s[-1]:.2f} s at most; {text} ({all_of_them})",
            f"{kills} of {kills} within {_GOAL_S} s",
            taken == within == kills,
        ),
        Figure("changes of the sender, one for each kill", str(len(found)), str(kills), len(found) == kills),
    ]
