"""The journal of a flight: vehicles, stations, residuals, changes of GPS state and notices.

Its entries are made at the engine's deadlines. It follows from the deadlines alone, so that a replay makes the same journal to
the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.engine import REVIEWED_EVERY_S, Engine
from gcs_coloc.core.messages.outbound import HealthChanged, Notice, Outbound
from gcs_coloc.core.residual_log import RangeSnapshot
from gcs_coloc.core.schedule import SAME_S
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.core.station_review import StationSnapshot

EVERY_S = 0.4  # chosen: every other review of the fleet


@dataclass(frozen=True, slots=True)
class VehicleEntry:
    """One vehicle at service time `at_s` (UNIX seconds)."""

    at_s: float
    vehicle: VehicleSnapshot


@dataclass(frozen=True, slots=True)
class RangeEntry:
    """The residual of one range at service time `at_s`; it was measured `range.age_s` before that."""

    at_s: float
    range: RangeSnapshot


@dataclass(frozen=True, slots=True)
class StationEntry:
    """A fixed station at service time `at_s`, when it came to be known or something of it changed."""

    at_s: float
    station: StationSnapshot


Entry = VehicleEntry | RangeEntry | StationEntry | HealthChanged | Notice | Alarm
"""Alarms are not the journal's own: they depend on what people acknowledge, and are the same in a replay but for that."""


class Journal:
    """The journal of one engine: every vehicle each 0.4 s, everything else as it comes.

    `newest_snapshot` is that of the newest vehicle entries.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.newest_snapshot: FleetSnapshot | None = None
        self._due_s = float("-inf")
        self._residual_times_s: dict[tuple[int, int], float] = {}
        self._stations: dict[int, StationSnapshot] = {}

    def entries(self, at_s: float, outputs: list[Outbound]) -> list[Entry]:
        """The entries of one deadline of the engine, from its time (s) and its outputs."""
        entries: list[Entry] = [output for output in outputs if isinstance(output, HealthChanged | Notice)]
        # No snapshot at a long deadline if a short one follows: datagrams must not wait for both.
        next_s = self._engine.next_deadline()
        is_long = next_s <= at_s or (self._engine.reviewed_at_s == at_s and next_s < at_s + REVIEWED_EVERY_S - SAME_S)
        if at_s < self._due_s or is_long:
            return entries
        self._due_s = at_s + EVERY_S - SAME_S
        view = self.newest_snapshot = self._engine.snapshot(at_s)
        entries.extend(VehicleEntry(at_s, vehicle) for vehicle in view.vehicles)
        for one in view.ranges:
            pair, measured_at_s = (one.from_sysid, one.to_sysid), at_s - one.age_s
            if measured_at_s > self._residual_times_s.get(pair, float("-inf")) + SAME_S:
                self._residual_times_s[pair] = measured_at_s
                entries.append(RangeEntry(at_s, one))
        for station in view.stations:
            known = self._stations.get(station.node)
            # The age of its newest range changes all the time.
            if known is None or replace(known, range_age_s=station.range_age_s) != station:
                self._stations[station.node] = station
                entries.append(StationEntry(at_s, station))
        return entries
