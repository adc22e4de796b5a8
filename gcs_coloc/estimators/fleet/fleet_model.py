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
from gcs_coloc.estimators.fleet.cluster_set import ClusterSet
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, NoiseSplit, without_time_error
from gcs_coloc.estimators.fleet.ekf.blocks import pair_key
from gcs_coloc.estimators.fleet.ekf.range_update import update_range
from gcs_coloc.estimators.fleet.ekf.records import Records, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.update import UpdateResult, time_stamp_offset_sigma_s, update_own, update_time_stamp_sigma
from gcs_coloc.estimators.fleet.initialisation import initialise_from_ranges, initialise_from_reports
from gcs_coloc.estimators.fleet.outliers import monitor_range
from gcs_coloc.estimators.fleet.peer_selection import is_selected
from gcs_coloc.estimators.fleet.settings import FleetSettings

_PRUNE_EVERY_S = 5.0
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
        self.clusters = ClusterSet(settings, self.records)
        self.pairs: dict[tuple[int, int, int], NoiseSplit] = {}
        self._pruned_at_s = -math.inf

    def copy(self) -> FleetModel:
        """Return an independent copy."""
        other = object.__new__(FleetModel)
        other.settings = self.settings
        other.records = self.records.copy()
        other.clusters = self.clusters.copy(other.records)
        other.pairs = self.pairs.copy()
        other._pruned_at_s = self._pruned_at_s
        return other

    def replace_from(self, other: FleetModel, vehicle: int) -> None:
        """Replace what this model has of the vehicles in a vehicle's cluster by a copy of what another model has of them."""
        members = other.clusters.members(vehicle)
        for member in members:
            self.clusters.remove(member)
            self.records.copy_from(other.records, member)
        self.clusters.add_copy(other.clusters[vehicle], members)
        for key, white in other.pairs.items():
            if key[0] in members:
                self.pairs[key] = white
        self._pruned_at_s = other._pruned_at_s

    def import_vehicles(self, other: FleetModel, vehicles: tuple[int, ...]) -> None:
        """Take from another model what it knows of vehicles that are in no cluster of this one."""
        for vehicle in vehicles:
            if vehicle in self.clusters or vehicle not in other.records:
                continue
            self.records.copy_from(other.records, vehicle)
            if vehicle in other.clusters and not any(v in self.clusters for v in other.clusters.members(vehicle)):
                self.replace_from(other, vehicle)

    def set_denied(self, denied: frozenset[int], at_s: float) -> None:
        """Change who is to be located; a new denied vehicle starts from its last reports if these are fresh."""
        for vehicle in sorted(denied):
            record = self.records.writable(vehicle)
            if record.denied_vehicle:
                continue
            record.denied_vehicle = True
            if vehicle not in self.clusters and not self._initialise(vehicle, at_s):
                record.no_estimate_reason = "no fresh position to start from, and not enough ranges yet"
        for vehicle in [v for v, record in self.records.items() if record.denied_vehicle and v not in denied]:
            record = self.records.writable(vehicle)
            record.denied_vehicle = False
            record.range_measurements = ()
            record.neighbours = {}
            # Its reports are trusted again and start a filter when one is needed.
            self.clusters.remove(vehicle)
            record.own_measurements = ()
            record.last_position = None
            record.no_estimate_reason = "no position report since its GPS was trusted again"

    def apply(self, m: Measurement) -> UpdateResult:
        """Take one measurement, not older than any before it."""
        if m.measured_at_s - self._pruned_at_s > _PRUNE_EVERY_S:
            self._prune(m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            return self._update_range(m)
        record = self.records.writable(m.vehicle)
        if isinstance(m, PositionMeasurement):
            return self._update_position(m, record)
        if isinstance(m, AltitudeMeasurement):
            record.altitude_noise = record.altitude_noise.updated(m.measured_at_s, ((m.up_m,),), (m.sigma_m,))
        record.add_own(m)
        cluster = self.clusters.get(m.vehicle)
        if cluster is None:
            return _NO_PART
        return update_own(cluster, m)

    def _update_position(self, m: PositionMeasurement, record: VehicleRecord) -> UpdateResult:
        if record.denied_vehicle:
            return UpdateResult("refused: position of a denied vehicle")
        record.static = m.static
        e, n, u = m.position_enu_m
        record.report_noise = record.report_noise.updated(m.measured_at_s, ((e, n), (u,)), without_time_error(m))
        record.add_own(m)
        record.last_position = m
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.static:
            return _NO_PART
        result = update_own(cluster, m)
        if result.used:
            record.reports_refused = 0
            return result
        record.reports_refused += 1
        if record.reports_refused >= _REPORTS_REFUSED_MOST:
            # The reports agree with each other and not with the filter: they are the only witness of this vehicle.
            self.clusters.remove(m.vehicle)
            record.own_measurements = (m,)
            record.reports_refused = 0
            return UpdateResult("peer restarted: its reports moved away")
        return result

    def _update_range(self, m: RangeMeasurement) -> UpdateResult:
        ends = (m.from_vehicle, m.to_vehicle)
        first, second = self.records.writable(ends[0]), self.records.writable(ends[1])
        denied = [(*ends, first)] if first.denied_vehicle else []
        if second.denied_vehicle:
            denied.append((*ends[::-1], second))
        if not denied:
            return _NO_SUBJECT
        for denied_vehicle, other, record in denied:
            record.add_range(m)
            record.last_range_s[other] = m.measured_at_s
            if not is_selected(self.clusters, self.records, denied_vehicle, other, m.measured_at_s, self.settings):
                return _NOT_WANTED
        cluster = self.clusters.common(*ends)
        if cluster is None:
            waiting = self._initialise_ends(ends, m.measured_at_s)
            if waiting is not None:
                return waiting
            cluster = self.clusters.merge(*ends)
        pair = pair_key(*ends, m.device_id)
        sigma_m, _ = without_time_error(m)
        white = self.pairs[pair] = self.pairs.get(pair, NO_SAMPLES).updated(m.measured_at_s, ((m.range_m,),), (sigma_m,))
        slow_m = self.settings.range_slow_share * white.split(0, sigma_m, self.settings.least_slow_share)[1]
        if m.clock_of in ends:
            update_time_stamp_sigma(cluster, m.clock_of, time_stamp_offset_sigma_s(m, self.settings))
        # A device that is seen to scatter more than it states is believed no more than that. Multipath of a tenth of the ranges,
        # which the gate weighs by itself, makes it seem to scatter up to 1.8 times as much.
        scatter_m = white.lower_bound_m(0)
        result = update_range(cluster, pair, m, scatter_m if scatter_m > _UNDERSTATED * sigma_m else sigma_m, slow_m)
        for denied_vehicle, other, _ in denied:
            monitor_range(cluster, denied_vehicle, other, result, m)
        return result

    def _initialise_ends(self, ends: tuple[int, int], at_s: float) -> UpdateResult | None:
        """Begin the states of those ends of a range that have none; what the range came to where that is not possible."""
        for vehicle in ends:
            if vehicle in self.clusters:
                continue
            if self.records[vehicle].denied_vehicle:
                begun = initialise_from_ranges(self.clusters, self.records, vehicle, at_s, self.settings)
                return UpdateResult("used for a start" if begun else "kept: waiting for a start")
            if not self._initialise(vehicle, at_s):
                return UpdateResult("refused: peer without a position")
        return None

    def _initialise(self, vehicle: int, at_s: float) -> bool:
        return initialise_from_reports(self.clusters, self.records, vehicle, at_s, self.settings)

    def _prune(self, at_s: float) -> None:
        """Drop peers that nobody ranges and vehicles silent for an hour, and part the clusters that nothing holds together."""
        self._pruned_at_s = at_s
        kept_s = self.settings.peer_kept_s
        links: dict[int, set[int]] = {}
        for vehicle in [v for v, record in self.records.items() if record.denied_vehicle]:
            record = self.records.writable(vehicle)
            record.last_range_s = {other: t for other, t in record.last_range_s.items() if at_s - t <= kept_s}
            record.neighbours = {other: n for other, n in record.neighbours.items() if at_s - n.at_s <= kept_s}
            for other in record.neighbours:
                links.setdefault(vehicle, set()).add(other)
                links.setdefault(other, set()).add(vehicle)
            cluster = self.clusters.get(vehicle)
            if cluster is not None and not record.static and at_s - cluster.joint.time_s[vehicle] > _SILENT_MOST_S:
                self.clusters.remove(vehicle)
                record.own_measurements = ()
                record.no_estimate_reason = "nothing was heard of it for more than an hour, and not enough ranges yet"
        self.clusters.prune(links)
        self.pairs = {key: white for key, white in self.pairs.items() if key[1] in links.get(key[0], ())}

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Answer from the state as it stands."""
        record = self.records.get(vehicle)
        if record is None:
            return NoEstimate(vehicle, at_s, "no measurement of it was heard")
        cluster = self.clusters.get(vehicle)
        if cluster is None:
            return self._estimate_without_state(vehicle, record, at_s)
        return answer(cluster, vehicle, at_s)

    def _estimate_without_state(self, vehicle: int, record: VehicleRecord, at_s: float) -> Estimate | NoEstimate:
        """Answer for a vehicle that has no filter: a healthy one from its own reports, a vehicle with the reason why not."""
        if record.denied_vehicle or record.last_position is None:
            return NoEstimate(vehicle, at_s, record.no_estimate_reason)
        age_s = at_s - record.last_position.measured_at_s
        if age_s > self.settings.start_age_s and not record.static:
            return NoEstimate(vehicle, at_s, f"no position report for {age_s:.0f} s")
        alone = FleetModel(self.settings)
        alone.records.copy_from(self.records, vehicle)
        if record.last_position.velocity_enu_mps is not None:
            # Its last report has all that a filter over the others would tell; this is asked often.
            alone.records[vehicle].own_measurements = ()
        alone._initialise(vehicle, at_s)
        return alone.estimate(vehicle, at_s)
