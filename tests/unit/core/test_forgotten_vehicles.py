"""A vehicle that makes room for another one is forgotten by every stage, so that tables stay bounded and it may return."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Set

from engine_flights import ALT, LAT, LON, StraightLine, fly, settings, telemetry

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.measurements import RangeMeasurement, Residual
from gcs_coloc.core.messages.control import ForeignGpsInput, RouteBlock, RouteReport, SwitchedByOther, SwitchedReceiver
from gcs_coloc.core.messages.inbound import (
    Autopilot,
    GlobalOrigin,
    ParameterValue,
    PeerRange,
    Pressure,
    SystemTime,
    TimeBase,
    TimeSyncAnswer,
)
from gcs_coloc.core.messages.outbound import ParameterSet
from gcs_coloc.core.telemetry.range_checks import RangeChecks

KNOWN, FOUNDERS, FORGED = (1, 2, 3, 4), (50, 51), range(100, 116)


class Residuals(StraightLine):
    """Refuses each range, so that every table of residuals is filled."""

    def drain_residuals(self) -> list[Residual]:
        ranges = [m for m in self.taken if isinstance(m, RangeMeasurement)]
        self.taken.clear()
        return [Residual(m.from_vehicle, m.to_vehicle, m.measured_at_s, 50.0, 1.0, 2500.0, 1, "gate") for m in ranges]


def said(sysids: Collection[int], t: float, fix_type: int, autopilot: Autopilot, *, is_shared: bool) -> Iterator[object]:
    """All that vehicles may say within a tenth of a second, and what is said of them."""
    for sysid in sysids:
        yield from telemetry(sysid, t, fix_type, autopilot)
        boot_s = t + 10.0 * sysid
        yield Pressure(sysid, t, boot_s, 950.0)
        yield SystemTime(sysid, t, boot_s, 1.7e9 + t)
        yield GlobalOrigin(sysid, t, LAT, LON, ALT)
        yield TimeSyncAnswer(sysid, t, round(t * 1e9), round(boot_s * 1e9))
        yield ParameterValue(sysid, t, "GPS_PRIMARY", 0.0, 2)
        yield ForeignGpsInput(255, t, 1, sysid)
        for peer in KNOWN:
            yield PeerRange(sysid, t, peer, 500.0 + t, 1.0, t, TimeBase.BOOT, 1, None, 7)
            yield PeerRange(peer, t, sysid, 500.0 + t, 1.0, t, TimeBase.BOOT, 1, None, 7)
        if is_shared:
            yield RouteReport(sysid, t, RouteBlock.SHARED_ADDRESS, tuple(other for other in sysids if other != sysid))


def fly_beside_known(
    engine: Engine, sysids: Collection[int], start_s: float, stop_s: float, *, autopilot: Autopilot, is_shared: bool = True
) -> None:
    """Fly vehicles that lose their GPS half-way, beside the known ones."""
    for step in range(round(start_s * 10), round(stop_s * 10)):
        t, is_late = step / 10, step > 5 * (start_s + stop_s)
        for message in said(sysids, t, 1 if is_late else 3, autopilot, is_shared=is_shared):
            engine.receive(message)
        fly(engine, t, t + 0.1, sysids=KNOWN)


def keys_below(root: object) -> Iterator[int]:
    """The integers among the keys of all tables that an object holds, but for those whose number has a bound of its own."""
    seen, waiting = set(), [root]
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, (str, bytes, int, float, type, StraightLine, RangeChecks)):
            continue
        seen.add(id(one))
        if isinstance(one, Mapping | Set):
            for key in one:
                yield from (part for part in (key if isinstance(key, tuple) else (key,)) if type(part) is int)
        if isinstance(one, Mapping):
            waiting.extend(one.values())
        elif isinstance(one, Iterable) and type(one).__module__ in ("builtins", "collections"):
            waiting.extend(one)
        waiting.extend(vars(one).values() if hasattr(one, "__dict__") else ())
        slots = (name for kind in type(one).__mro__ for name in getattr(kind, "__slots__", ()))
        waiting.extend(getattr(one, name) for name in slots if hasattr(one, name))


def test_no_stage_keeps_anything_of_a_vehicle_that_made_room():
    engine = Engine(Residuals(), settings(max_vehicles=8))
    # Two found the fleet, and count for a while, until they are heard from one address.
    fly_beside_known(engine, FOUNDERS, 0.0, 8.0, autopilot=Autopilot.ARDUPILOT, is_shared=False)
    assert engine.proven.is_proven(FOUNDERS[0])
    fly_beside_known(engine, FOUNDERS, 8.0, 9.0, autopilot=Autopilot.ARDUPILOT)
    assert not engine.proven.is_proven(FOUNDERS[0])
    assert set(FOUNDERS) <= set(keys_below(engine))
    for k, first in enumerate(range(FORGED.start, FORGED.stop, 2)):
        autopilot = Autopilot.PX4 if k % 2 else Autopilot.ARDUPILOT
        fly_beside_known(engine, (first, first + 1), 20.0 + 4.0 * k, 22.0 + 4.0 * k, autopilot=autopilot)
    assert len(engine.sysids()) == 8
    assert set(KNOWN) <= set(engine.sysids())
    assert {*FOUNDERS, *FORGED} & set(keys_below(engine)) <= set(engine.sysids())


def test_a_vehicle_that_made_room_and_returns_begins_anew():
    estimator = StraightLine()
    engine = Engine(estimator, settings(max_vehicles=6))
    fly(engine, 0.0, 12.0)
    fly_beside_known(engine, (100, 101), 12.0, 16.0, autopilot=Autopilot.ARDUPILOT)
    assert engine.gps_state(100) is GpsState.FAILED
    assert estimator.denied[-1][0] == {100, 101}
    fly_beside_known(engine, (102, 103), 16.0, 18.0, autopilot=Autopilot.ARDUPILOT)
    assert estimator.denied[-1][0] <= {102, 103}
    fly_beside_known(engine, (100,), 18.0, 18.1, autopilot=Autopilot.ARDUPILOT)
    assert engine.gps_state(100) is GpsState.HEALTHY


def test_a_vehicle_whose_own_receiver_is_to_be_restored_makes_no_room():
    engine = Engine(StraightLine(), settings(max_vehicles=6))
    fly(engine, 0.0, 12.0)
    fly_beside_known(engine, (100, 101), 12.0, 13.0, autopilot=Autopilot.ARDUPILOT)
    engine.receive(SwitchedByOther(13.0, SwitchedReceiver(100, 1.0, 2), held=True))
    for first in (102, 104):
        fly_beside_known(engine, (first, first + 1), first - 88.0, first - 87.0, autopilot=Autopilot.ARDUPILOT)
    assert 100 in engine.sysids()
    assert 101 not in engine.sysids()
    assert [o for o in engine.close() if isinstance(o, ParameterSet)] == [ParameterSet(100, "GPS_PRIMARY", 1.0, 2)]
