"""The fleet as the filter knows it, fed in the order of measuring: who is a vehicle, in which cluster, and who is used as a peer.

Only vehicles that a vehicle ranges have states in a filter. Of any other healthy vehicle only a few recent reports are kept,
from which a filter for it is started at the moment when it is needed.
"""

from __future__ import annotations

import math

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
)
from gcs_coloc.estimators.fleet.answer import answer
from gcs_coloc.estimators.fleet.begin import begin_from_ranges, begin_from_reports
from gcs_coloc.estimators.fleet.blocks import pair_key
from gcs_coloc.estimators.fleet.clusters import Clusters
from gcs_coloc.estimators.fleet.corrections import UpdateResult, restate_clock, stamp_sigma_s, take_own
from gcs_coloc.estimators.fleet.noise import NOTHING_HEARD, Whiteness, without_time_error
from gcs_coloc.estimators.fleet.peers import is_wanted
from gcs_coloc.estimators.fleet.range import account, take_range
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.estimators.fleet.vehicle import Records, VehicleRecord

_TIDY_EVERY_S = 5.0
_REPORTS_REFUSED_MOST = 10
_UNDERSTATED = 1.8
_SILENT_MOST_S = 3600.0
"""A state that nothing was heard of for longer says nothing; left to grow, it loses its digits within a month."""

_NO_PART = UpdateResult("kept: vehicle has no part in locating a denied vehicle")
_NO_SUBJECT = UpdateResult("kept: range between healthy vehicles")
_NOT_WANTED = UpdateResult("kept: better placed peers are used")


class FleetModel:
    """The state of the whole filter. `copy` is an independent copy; everything else changes it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.settings = settings
        self.records = Records()
        self.clusters = Clusters(settings, self.records)
        self.pairs: dict[tuple[int, int, int], Whiteness] = {}
        self._tidied_at_s = -math.inf

    def copy(self) -> FleetModel:
        """Return an independent copy."""
        other = object.__new__(FleetModel)
        other.settings = self.settings
        other.records = self.records.copy()
        other.clusters = self.clusters.copy(other.records)
        other.pairs = self.pairs.copy()
        other._tidied_at_s = self._tidied_at_s
        return other

    def take_over(self, other: FleetModel, vehicle: int) -> None:
        """Replace what this model has of the vehicles in a vehicle's cluster by a copy of what another model has of them."""
        members = other.clusters.together_with(vehicle)
        for member in members:
            self.clusters.drop(member)
            self.records.take(other.records, member)
        self.clusters.adopt(other.clusters[vehicle], members)
        for key, white in other.pairs.items():
            if key[0] in members:
                self.pairs[key] = white
        self._tidied_at_s = other._tidied_at_s

    def learn(self, other: FleetModel, vehicles: tuple[int, ...]) -> None:
        """Take from another model what it knows of vehicles that are in no cluster of this one."""
        for vehicle in vehicles:
            if vehicle in self.clusters or vehicle not in other.records:
                continue
            self.records.take(other.records, vehicle)
            if vehicle in other.clusters and not any(v in self.clusters for v in other.clusters.together_with(vehicle)):
                self.take_over(other, vehicle)

    def set_denied(self, denied: frozenset[int], at_s: float) -> None:
        """Change who is to be located; a new denied vehicle starts from its last reports if these are fresh."""
        for vehicle in sorted(denied):
            record = self.records.writable(vehicle)
            if record.denied_vehicle:
                continue
            record.denied_vehicle = True
            if vehicle not in self.clusters and not self._activate(vehicle, at_s):
                record.reason = "no fresh position to start from, and not enough ranges yet"
        for vehicle in [v for v, record in self.records.items() if record.denied_vehicle and v not in denied]:
            record = self.records.writable(vehicle)
            record.denied_vehicle = False
            record.ranged = ()
            record.neighbours = {}
            # Its reports are trusted again and start a filter when one is needed.
            self.clusters.drop(vehicle)
            record.own = ()
            record.last_position = None
            record.reason = "no position report since its GPS was trusted again"

    def apply(self, m: Measurement) -> UpdateResult:
        """Take one measurement, not older than any before it."""
        if m.measured_at_s - self._tidied_at_s > _TIDY_EVERY_S:
            self._tidy(m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            return self._range(m)
        record = self.records.writable(m.vehicle)
        if isinstance(m, PositionMeasurement):
            return self._position(m, record)
        if isinstance(m, AltitudeMeasurement):
            record.white_baro = record.white_baro.heard(m.measured_at_s, ((m.up_m,),), (m.sigma_m,))
        record.remember(m)
        cluster = self.clusters.get(m.vehicle)
        if cluster is None:
            return _NO_PART
        return take_own(cluster, m)

    def _position(self, m: PositionMeasurement, record: VehicleRecord) -> UpdateResult:
        if record.denied_vehicle:
            return UpdateResult("refused: position of a denied vehicle")
        record.fixed = m.static
        e, n, u = m.position_enu_m
        record.white = record.white.heard(m.measured_at_s, ((e, n), (u,)), without_time_error(m))
        record.remember(m)
        record.last_position = m
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.fixed:
            return _NO_PART
        verdict = take_own(cluster, m)
        if verdict.used:
            record.reports_refused = 0
            return verdict
        record.reports_refused += 1
        if record.reports_refused >= _REPORTS_REFUSED_MOST:
            # The reports agree with each other and not with the filter: they are the only witness of this vehicle.
            self.clusters.drop(m.vehicle)
            record.own = (m,)
            record.reports_refused = 0
            return UpdateResult("peer restarted: its reports moved away")
        return verdict

    def _range(self, m: RangeMeasurement) -> UpdateResult:
        ends = (m.from_vehicle, m.to_vehicle)
        first, second = self.records.writable(ends[0]), self.records.writable(ends[1])
        denied = [(*ends, first)] if first.denied_vehicle else []
        if second.denied_vehicle:
            denied.append((*ends[::-1], second))
        if not denied:
            return _NO_SUBJECT
        for denied_vehicle, other, record in denied:
            record.remember_range(m)
            record.heard[other] = m.measured_at_s
            if not is_wanted(self.clusters, self.records, denied_vehicle, other, m.measured_at_s, self.settings):
                return _NOT_WANTED
        cluster = self.clusters.common(*ends)
        if cluster is None:
            waiting = self._locate(ends, m.measured_at_s)
            if waiting is not None:
                return waiting
            cluster = self.clusters.merge(*ends)
        pair = pair_key(*ends, m.device_id)
        sigma_m, _ = without_time_error(m)
        white = self.pairs[pair] = self.pairs.get(pair, NOTHING_HEARD).heard(m.measured_at_s, ((m.range_m,),), (sigma_m,))
        slow_m = self.settings.range_slow_share * white.split(0, sigma_m, self.settings.least_slow_share)[1]
        if m.clock_of in ends:
            restate_clock(cluster, m.clock_of, stamp_sigma_s(m, self.settings))
        # A device that is seen to scatter more than it states is believed no more than that. Multipath of a tenth of the ranges,
        # which the gate weighs by itself, makes it seem to scatter up to 1.8 times as much.
        scatter_m = white.proven_m(0)
        verdict = take_range(cluster, pair, m, scatter_m if scatter_m > _UNDERSTATED * sigma_m else sigma_m, slow_m)
        for denied_vehicle, other, _ in denied:
            account(cluster, denied_vehicle, other, verdict, m)
        return verdict

    def _locate(self, ends: tuple[int, int], at_s: float) -> UpdateResult | None:
        """Begin the states of those ends of a range that have none; what the range came to where that is not possible."""
        for vehicle in ends:
            if vehicle in self.clusters:
                continue
            if self.records[vehicle].denied_vehicle:
                begun = begin_from_ranges(self.clusters, self.records, vehicle, at_s, self.settings)
                return UpdateResult("used for a start" if begun else "kept: waiting for a start")
            if not self._activate(vehicle, at_s):
                return UpdateResult("refused: peer without a position")
        return None

    def _activate(self, vehicle: int, at_s: float) -> bool:
        return begin_from_reports(self.clusters, self.records, vehicle, at_s, self.settings)

    def _tidy(self, at_s: float) -> None:
        """Drop peers that nobody ranges and vehicles silent for an hour, and part the clusters that nothing holds together."""
        self._tidied_at_s = at_s
        kept_s = self.settings.peer_kept_s
        links: dict[int, set[int]] = {}
        for vehicle in [v for v, record in self.records.items() if record.denied_vehicle]:
            record = self.records.writable(vehicle)
            record.heard = {other: t for other, t in record.heard.items() if at_s - t <= kept_s}
            record.neighbours = {other: n for other, n in record.neighbours.items() if at_s - n.at_s <= kept_s}
            for other in record.neighbours:
                links.setdefault(vehicle, set()).add(other)
                links.setdefault(other, set()).add(vehicle)
            cluster = self.clusters.get(vehicle)
            if cluster is not None and not record.fixed and at_s - cluster.joint.time_s[vehicle] > _SILENT_MOST_S:
                self.clusters.drop(vehicle)
                record.own = ()
                record.reason = "nothing was heard of it for more than an hour, and not enough ranges yet"
        self.clusters.part(links)
        self.pairs = {key: white for key, white in self.pairs.items() if key[1] in links.get(key[0], ())}

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer from the state as it stands."""
        record = self.records.get(vehicle)
        if record is None:
            return NoEstimate(vehicle, at_s, "no measurement of it was heard")
        cluster = self.clusters.get(vehicle)
        if cluster is None:
            return self._idle(vehicle, record, at_s)
        return answer(cluster, vehicle, at_s)

    def _idle(self, vehicle: int, record: VehicleRecord, at_s: float) -> Estimate | NoEstimate:
        """Answer for a vehicle that has no filter: a healthy one from its own reports, a vehicle with the reason why not."""
        if record.denied_vehicle or record.last_position is None:
            return NoEstimate(vehicle, at_s, record.reason)
        age_s = at_s - record.last_position.measured_at_s
        if age_s > self.settings.start_age_s and not record.fixed:
            return NoEstimate(vehicle, at_s, f"no position report for {age_s:.0f} s")
        alone = FleetModel(self.settings)
        alone.records.take(self.records, vehicle)
        if record.last_position.velocity_enu_mps is not None:
            # Its last report has all that a filter over the others would tell; this is asked often.
            alone.records[vehicle].own = ()
        alone._activate(vehicle, at_s)
        return alone.estimate(vehicle, at_s)
