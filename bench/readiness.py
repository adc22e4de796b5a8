"""What readiness costs: 30 healthy vehicles, each ranged with eight others, through the engine."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from bench.figures import Figure
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.messages.control import RouteReport
from gcs_coloc.core.messages.inbound import (
    Airspeed,
    Attitude,
    Autopilot,
    GlobalPosition,
    GpsReceiver,
    Heartbeat,
    Inbound,
    PeerRange,
    TimeBase,
)
from gcs_coloc.core.readiness.readiness_review import RecentRanges
from gcs_coloc.estimators.registry import load_estimator

_VEHICLES = 30
_PEERS = 8
_RATE_HZ = 5.0
_FIELD_M = 3000.0
_SPEED_MPS = 20.0
_WARM_S = 6.0
_MOST_SHARE = 0.02
_PREDICTED_S = 1e-3
"""A review that takes longer has predicted a vehicle. Chosen: one that finds nothing due takes 0.1 ms."""
_FRAME = LocalFrame(47.0, 8.0, 500.0)


def measure(quick: bool) -> list[Figure]:
    """Count the CPU time within the review of readiness, beside that of the engine as a whole in the same run."""
    flown_s = 15.0 if quick else 60.0
    fleet, engine = _Fleet(), Engine(load_estimator("fleet", {}), EngineSettings(request_streams=False))
    # The engine has no seam for a clock in it: the two steps that are measured are wrapped.
    review, ranges = engine._review, _TimedRanges()  # noqa: SLF001
    object.__setattr__(review._stages, "ranges", ranges)  # noqa: SLF001
    predict, spent_s, longest_s, count = review.review_readiness, 0.0, 0.0, 0

    def timed(now_s: float) -> None:
        nonlocal spent_s, longest_s, count
        began_s = time.process_time()
        predict(now_s)
        took_s = time.process_time() - began_s
        if now_s >= _WARM_S:
            spent_s, longest_s = spent_s + took_s, max(longest_s, took_s)
            count += took_s > _PREDICTED_S

    review.review_readiness = timed  # type: ignore[method-assign]
    began_s, t = 0.0, 0.0
    while t < _WARM_S + flown_s:
        if began_s == 0.0 and t >= _WARM_S:
            began_s, ranges.spent_s = time.process_time(), 0.0
        for message in fleet.messages(t):
            engine.receive(message)
        t = round(t + 1.0 / _RATE_HZ, 3)
        while engine.next_deadline() < t:
            engine.poll(engine.next_deadline())
    whole_s = time.process_time() - began_s
    kept_s = ranges.spent_s
    share = (spent_s + kept_s) / flown_s
    states = {str(v.readiness.state) for v in engine.snapshot(t).vehicles if v.readiness is not None}
    what = f"readiness of {_VEHICLES} vehicles with {_PEERS} peers or more ({', '.join(sorted(states))})"
    return [
        Figure(f"CPU, {what}", f"{share:.1%} of a core", "<= 2 %", share <= _MOST_SHARE),
        Figure("share of the engine's CPU time in the same run", f"{(spent_s + kept_s) / whole_s:.1%}"),
        Figure(
            f"a prediction ({count} of them)",
            f"{spent_s / max(count, 1) * 1e3:.1f} ms on average, {longest_s * 1e3:.1f} ms at most",
        ),
    ]


class _TimedRanges(RecentRanges):
    """Counts what it costs to keep the ranges; with the clock's own cost, which is as large."""

    def __init__(self) -> None:
        super().__init__()
        self.spent_s = 0.0

    def add(self, measurement: object) -> None:
        began_s = time.perf_counter()
        super().add(measurement)  # type: ignore[arg-type]
        self.spent_s += time.perf_counter() - began_s


class _Fleet:
    """Planes on straight ways all over a field."""

    def __init__(self) -> None:
        rng = self._rng = np.random.default_rng(1)
        self._start = np.column_stack([rng.uniform(-0.5, 0.5, (_VEHICLES, 2)) * _FIELD_M, rng.uniform(50.0, 150.0, _VEHICLES)])
        self._course = rng.uniform(0.0, 2.0 * np.pi, _VEHICLES)
        self._velocity = _SPEED_MPS * np.column_stack([np.sin(self._course), np.cos(self._course), np.zeros(_VEHICLES)])

    def messages(self, t: float) -> Iterator[Inbound]:
        """Yield all that is sent at a time."""
        places = self._start + self._velocity * t
        for k in range(_VEHICLES):
            sysid, (east_m, north_m, up_m), (ve, vn, _) = k + 1, places[k].tolist(), self._velocity[k].tolist()
            lat, lon, alt = _FRAME.geodetic_from_enu(east_m, north_m, up_m)
            yield GlobalPosition(sysid, t, t, lat, lon, alt, vn, ve, 0.0)
            yield GpsReceiver(sysid, t, 0, 3, lat, lon, alt, 12, 0.9, 1.0, 1.6, 0.3)
            yield Attitude(sysid, t, t, 0.0, 0.0, float(self._course[k]))
            yield Airspeed(sysid, t, _SPEED_MPS)
            if round(t * _RATE_HZ) % round(_RATE_HZ) == 0:
                yield Heartbeat(sysid, t, Autopilot.ARDUPILOT, True, winged=True)
                yield RouteReport(sysid, t, None)
            for step in range(1, _PEERS + 1):
                other = (k + step) % _VEHICLES
                range_m = float(np.linalg.norm(places[k] - places[other]) + self._rng.normal())
                yield PeerRange(sysid, t, other + 1, range_m, 1.0, t, TimeBase.SERVICE, None, None, 0)
