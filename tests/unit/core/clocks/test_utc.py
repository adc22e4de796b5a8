"""What time it is, and what happens when the host does not know: told once, and by setting no aid."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from gcs_coloc.core.clocks.utc import gps_week_and_ms
from gcs_coloc.core.clocks.vehicle_clocks import TimeSettings
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.measurements import Estimate
from gcs_coloc.core.messages.control import ClockReference, GpsOverride, OperatorCommand, RouteBlock, RouteReport
from gcs_coloc.core.messages.inbound import Airspeed, Attitude, Autopilot, GlobalPosition, GpsReceiver, Heartbeat, SystemTime
from gcs_coloc.core.messages.outbound import GpsInput, Notice, TimeSyncRequest
from gcs_coloc.runtime.clock import is_synchronised

UNIX_S = 1_780_000_000.0


class Somewhere:
    """An estimator for these tests: everybody is at the origin."""

    name = "somewhere"

    def set_denied(self, denied, at_s):
        """Nothing depends on it here."""

    def reset(self, vehicle, at_s):
        """Nothing depends on it here."""

    def add(self, measurement):
        """Nothing depends on it here."""

    def estimate(self, vehicle, at_s):
        return Estimate(vehicle, at_s, np.zeros(3), np.zeros(3), np.eye(6), 1.0, 3)

    def drain_residuals(self):
        return []

    def counts(self):
        return {}


def engine(required: bool = False) -> Engine:
    return Engine(Somewhere(), EngineSettings(request_streams=False, time=TimeSettings(require_synchronised_clock=required)))


def fly(e: Engine, start_s: float, stop_s: float, utc_error_s: float = 0.0) -> list:
    """Vehicles 1 to 3 are healthy and know UTC (3 is wrong by `utc_error_s`), vehicle 4 is declared failed."""
    e.receive(OperatorCommand(4, start_s, GpsOverride.FAILED))
    out = []
    for step in range(round(start_s * 10), round(stop_s * 10)):
        t = step / 10
        for sysid in (1, 2, 3, 4):
            e.receive(GlobalPosition(sysid, t, t + sysid, 47.0, 8.0, 500.0, 0.0, 0.0, 0.0))
            e.receive(GpsReceiver(sysid, t, 0, 3, 47.0, 8.0, 500.0, 10, 1.0, 1.0, 1.0, 0.5))
            unix_s = None if sysid == 4 else UNIX_S + t + (utc_error_s if sysid == 3 else 0.0)
            e.receive(SystemTime(sysid, t, t + sysid, unix_s))
            e.receive(Heartbeat(sysid, t, Autopilot.ARDUPILOT, True, winged=True))
            e.receive(RouteReport(sysid, t, None))
            e.receive(Attitude(sysid, t, t + sysid, 0.0, 0.0, 0.0))
            e.receive(Airspeed(sysid, t, 20.0))
        out += e.poll(t)
    return out


def aids(out: list) -> list[GpsInput]:
    return [o for o in out if isinstance(o, GpsInput) and o.fix_type == 3]


def texts(out: list) -> list[str]:
    return [o.text for o in out if isinstance(o, Notice) and "clock is" in o.text]


def test_a_clock_that_is_not_synchronised_is_told_once_per_change():
    e = engine()
    out = []
    for t, state in enumerate([None, False, False, True, True, False]):
        e.receive(ClockReference(float(t), UNIX_S, state))
        out += e.poll(float(t))
    assert [text.split("(")[0].split(":")[0].strip() for text in texts(out)] == [
        "the host's clock is not synchronised",
        "the host's clock is synchronised",
        "the host's clock is not synchronised",
    ]


@pytest.mark.parametrize("state", [None, False])
def test_where_a_synchronised_clock_is_required_no_aid_is_sent_without(state):
    e = engine(required=True)
    e.receive(ClockReference(0.0, UNIX_S, state))
    out = fly(e, 0.0, 3.0)
    assert not [o for o in out if isinstance(o, GpsInput)]
    assert "clock is" in next(v.aiding for v in e.snapshot(3.0).vehicles if v.sysid == 4)
    e.receive(ClockReference(3.0, UNIX_S, True))
    assert len(aids(fly(e, 3.0, 4.0))) >= 9
    e.receive(ClockReference(4.0, UNIX_S, state))
    out = fly(e, 4.0, 5.0)
    assert [o.fix_type for o in out if isinstance(o, GpsInput)] == [1]


def week_offset_s(aid: GpsInput) -> float:
    return aid.gps_week * 604800.0 + aid.gps_time_of_week_ms / 1e3


def truth_s(at_s: float) -> float:
    week, ms = gps_week_and_ms(UNIX_S + at_s)
    return week * 604800.0 + ms / 1e3


def test_the_vehicles_time_is_used_where_the_hosts_is_wrong_or_unknown():
    for reference in (ClockReference(0.0, UNIX_S + 5000.0, False), ClockReference(0.0, None, None)):
        e = engine()
        e.receive(reference)
        aid = aids(fly(e, 0.0, 5.0, utc_error_s=-777.0))[-1]
        # Sent at 4.9 s for 0.1 s before; the third vehicle's wrong time is outvoted.
        assert week_offset_s(aid) == pytest.approx(truth_s(4.8), abs=2e-3)


def test_the_hosts_time_is_used_where_it_is_disciplined_whatever_the_vehicles_say():
    e = engine()
    e.receive(ClockReference(0.0, UNIX_S - 9.0, True))
    assert week_offset_s(aids(fly(e, 0.0, 5.0))[-1]) == pytest.approx(truth_s(4.8) - 9.0, abs=2e-3)


def test_each_vehicle_is_asked_for_its_time_and_one_without_a_route_is_not():
    e = engine()
    out = fly(e, 0.0, 2.0)
    assert {o.sysid for o in out if isinstance(o, TimeSyncRequest)} == {1, 2, 3, 4}
    e.receive(RouteReport(2, 2.0, RouteBlock.SHARED_ADDRESS))
    assert 2 not in {o.sysid for t in (2.0, 2.3, 2.6) for o in e.poll(t) if isinstance(o, TimeSyncRequest)}


def test_the_hosts_word_is_the_kernels():
    class Timex(ctypes.Structure):
        _fields_ = (("modes", ctypes.c_uint), ("rest", ctypes.c_long * 63))

    # The same kernel through its other door; 5 is TIME_ERROR in <sys/timex.h>.
    assert is_synchronised() == (ctypes.CDLL("libc.so.6").ntp_adjtime(ctypes.byref(Timex())) != 5)


def test_a_host_without_adjtimex_does_not_tell(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    assert is_synchronised() is None
