"""The fleet as one filter models it: records of all vehicles, and clusters with states.

It is updated in the order of measuring. Only vehicles that a denied vehicle ranges have states. Of any other healthy vehicle only
a few recent reports are kept, from which its states are initialised when a range needs them.
"""

from __future__ import annotations

import math
from dataclasses import replace

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    Measurement,
    NoEstimate,
    NoEstimateReason,
    PositionMeasurement,
    RangeMeasurement,
    Unlocated,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ambiguity.range_evidence import add_missed_turn, monitor_range
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import PairNoise, without_time_error
from gcs_coloc.estimators.fleet.ekf.air_data import AIR_UNSUSPECTED
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster, ClusterSet
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome, UpdateResult
from gcs_coloc.estimators.fleet.ekf.possible_motion import motion_profile
from gcs_coloc.estimators.fleet.ekf.records import Records, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import Key, pair_key
from gcs_coloc.estimators.fleet.ekf.tilt import Tilt
from gcs_coloc.estimators.fleet.ekf.update import (
    change_time_stamp_offset_sigma,
    time_stamp_offset_sigma_s,
    update_own,
    update_range,
)
from gcs_coloc.estimators.fleet.estimates import estimate_of_cluster, estimate_of_search
from gcs_coloc.estimators.fleet.gaps import decide_unshown_motion
from gcs_coloc.estimators.fleet.initialisation import (
    calibrate_air_data,
    initialise_from_ranges,
    initialise_from_reports,
    learn_manoeuvres,
)
from gcs_coloc.estimators.fleet.observed_biases import observe_bias, pair_bias, presume_bias, unknown_errors
from gcs_coloc.estimators.fleet.peer_selection import is_selected
from gcs_coloc.estimators.fleet.range_biases import PairBias
from gcs_coloc.estimators.fleet.searched_vehicles import begin_by_slow_ranges, is_searching, predicted_search, search_with_range
from gcs_coloc.estimators.fleet.settings import FleetSettings

_PRUNE_EVERY_S = 5.0  # chosen: pruning walks over all vehicles
_REPORTS_REFUSED_MOST = 10  # chosen: reports refused in a row agree with each other, not with the filter: a second at 10 Hz
UNDERSTATED = 1.8
"""Observed scatter over stated sigma from which on a device counts as optimistic: multipath of a tenth of the ranges, which the
gate weighs one by one, looks like up to 1.8 times the noise."""
_SILENT_MOST_S = 3600.0
"""Chosen: a state without updates for longer carries no information; growing for a month it would lose its digits."""


class FleetModel:
    """Records and clusters of one fleet. All methods but `copy` and `estimate` change it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.settings = settings
        self.records = Records(unreported=motion_profile(None, settings))
        self.clusters = ClusterSet(settings, self.records)
        self.pairs: dict[tuple[int, int, int], PairNoise] = {}
        self.considered_m: dict[Key, float] = {}
        self._pruned_at_s = -math.inf

    def copy(self) -> FleetModel:
        """Return an independent copy."""
        other = object.__new__(FleetModel)
        other.settings = self.settings
        other.records = self.records.copy()
        other.clusters = self.clusters.copy(other.records)
        other.pairs = self.pairs.copy()
        other.considered_m = self.considered_m.copy()
        other._pruned_at_s = self._pruned_at_s
        return other

    def replace_from(self, other: FleetModel, vehicle: int) -> None:
        """Replace the vehicles of one vehicle's cluster by copies of those in another model."""
        members = other.clusters.members(vehicle)
        for member in members:
            self.clusters.remove(member)
            self._copy_record(other, member)
        self.clusters.add_copy(other.clusters[vehicle], members)
        for key, noise in other.pairs.items():
            if key[0] in members:
                self.pairs[key] = noise
                if key in other.considered_m:
                    self.considered_m[key] = other.considered_m[key]
                else:
                    self.considered_m.pop(key, None)
        self._pruned_at_s = other._pruned_at_s

    def import_vehicles(self, other: FleetModel, vehicles: tuple[int, ...]) -> None:
        """Copy clusterless vehicles from another model, with their clusters where none of these is here."""
        for vehicle in vehicles:
            if vehicle in self.clusters or vehicle not in other.records:
                continue
            self._copy_record(other, vehicle)
            if vehicle in other.clusters and not any(v in self.clusters for v in other.clusters.members(vehicle)):
                self.replace_from(other, vehicle)

    def _copy_record(self, other: FleetModel, vehicle: int) -> None:
        """Copy a vehicle's record from another model.

        The records of vehicles that it has ranged are copied where they are missing: the peer selection needs them.
        """
        self.records.copy_from(other.records, vehicle)
        for neighbour in self.records[vehicle].last_range_s:
            if neighbour not in self.records:
                self.records.copy_from(other.records, neighbour)

    def set_denied(self, denied: frozenset[int], at_s: float) -> None:
        """Change which vehicles are denied; a new one is initialised from its last reports if these are fresh."""
        for vehicle in sorted(denied):
            record = self.records.writable(vehicle)
            if record.denied_vehicle:
                continue
            record.denied_vehicle = True
            if record.static:
                # A denied vehicle's states are those of a moving one.
                record.static = False
                self.clusters.remove(vehicle)
            if vehicle not in self.clusters and not initialise_from_reports(self.clusters, vehicle, at_s):
                record.no_estimate_reason = Unlocated(NoEstimateReason.NO_START)
            record.gaps_added_until_s = record.told_at_s = record.updated_at_s
        for vehicle in [v for v, record in self.records.items() if record.denied_vehicle and v not in denied]:
            record = self.records.writable(vehicle)
            record.denied_vehicle = False
            record.range_measurements = ()
            record.search = record.unshown = None
            record.neighbours = {}
            record.forget_tests()
            # Its new reports initialise its states when a range needs them; the old ones are not to be trusted.
            self.clusters.remove(vehicle)
            record.own_measurements = record.air_calibrations = ()
            record.air_check = AIR_UNSUSPECTED
            record.height_jumps_m = 0.0
            record.last_position = None
            record.no_estimate_reason = Unlocated(NoEstimateReason.NO_REPORT_SINCE_TRUSTED)

    def apply(self, m: Measurement, open_sides: frozenset[int] = frozenset()) -> UpdateResult:
        """Update with one measurement, not older than any before it.

        `open_sides` are denied vehicles that may be elsewhere by another hypothesis: no other one is searched by ranges to them.
        """
        if m.measured_at_s - self._pruned_at_s > _PRUNE_EVERY_S:
            self._prune(m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            return self._update_range(m, open_sides)
        record = self.records.writable(m.vehicle)
        if isinstance(m, VehicleClassReport):
            profile = motion_profile(m.vehicle_class, self.settings)
            if profile.tilts and not record.profile.tilts and record.attitude is not None:
                # On its wings no tilt accelerated it: none of what begins now is steady yet.
                record.tilt = Tilt(m.measured_at_s, 0.0, 0.0, 0.0, 0.0)
            record.profile = profile
            return UpdateResult(Outcome.CLASS_REPORTED)
        if isinstance(m, PositionMeasurement):
            return self._update_position(m, record)
        if isinstance(m, AltitudeMeasurement):
            record.altitude_noise = record.altitude_noise.updated(m.measured_at_s, ((m.up_m,),), (m.sigma_m,))
            m = replace(m, up_m=m.up_m - record.height_jumps_m)
        record.add_own(m)
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.static:
            if record.search is not None and isinstance(m, AltitudeMeasurement):
                search = predicted_search(record.search, record.profile, m.measured_at_s, self.settings)
                record.search = search.with_height(m.up_m, m.sigma_m**2)
            return UpdateResult(Outcome.KEPT_NO_STATE)
        return update_own(cluster, m)

    def _update_position(self, m: PositionMeasurement, record: VehicleRecord) -> UpdateResult:
        if record.denied_vehicle:
            return UpdateResult(Outcome.REFUSED_DENIED_POSITION)
        if record.static is not m.static:
            # An anchor's block is its position alone: the states are initialised anew.
            record.static = m.static
            self.clusters.remove(m.vehicle)
        e, n, u = m.position_enu_m
        record.report_noise = record.report_noise.updated(m.measured_at_s, ((e, n), (u,)), without_time_error(m))
        record.add_own(m)
        calibrate_air_data(record, m, self.settings)
        record.last_position = m
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.static:
            learn_manoeuvres(record, m, self.settings)
            return UpdateResult(Outcome.KEPT_NO_STATE)
        result = update_own(cluster, m)
        if result.used:
            record.reports_refused = 0
            return result
        record.reports_refused += 1
        if record.reports_refused >= _REPORTS_REFUSED_MOST:
            self.clusters.remove(m.vehicle)
            record.own_measurements = (m,)
            record.reports_refused = 0
            return UpdateResult(Outcome.REINITIALISED)
        return result

    def _update_range(self, m: RangeMeasurement, open_sides: frozenset[int]) -> UpdateResult:
        ends = m.ends
        first, second = self.records.writable(ends[0]), self.records.writable(ends[1])
        denied = [(*ends, first)] if first.denied_vehicle else []
        if second.denied_vehicle:
            denied.append((*ends[::-1], second))
        if not denied:
            return UpdateResult(Outcome.KEPT_NOT_DENIED)
        for _, other, record in denied:
            record.add_range(m)
            presume_bias(record, m.sigma_m * math.sqrt(m.samples), self.settings)
            record.last_range_s[other] = m.measured_at_s
        # Both ends select, whichever of them measured the range.
        selected = [is_selected(self.clusters, end, other, m.measured_at_s) for end, other, _ in denied]
        if not all(selected):
            return UpdateResult(Outcome.KEPT_NOT_SELECTED)
        searching = [is_searching(self.clusters, vehicle, other, m) for vehicle, other, _ in denied]
        if any(searching):
            outcomes = [
                search_with_range(self.clusters, *denied[i][:2], m)
                for i, wanted in enumerate(searching)
                if wanted and denied[i][1] not in open_sides
            ]
            return UpdateResult(outcomes[0] if outcomes else Outcome.KEPT_OPEN_SIDE)
        cluster = self.clusters.common(*ends)
        if cluster is None:
            waiting = self._initialise_ends(ends, m, open_sides)
            if waiting is not None:
                return waiting
            cluster = self.clusters.merge(*ends)
        pair = pair_key(*ends, m.device_id)
        sigma_m, _ = without_time_error(m)
        before = self.pairs.get(pair, PairNoise())
        noise = self.pairs[pair] = before.updated(m.measured_at_s, cluster.between_references_m(m), sigma_m)
        coloured_m = self.settings.range_coloured_share * noise.used.split(0, sigma_m, self.settings.least_coloured_share)[1]
        if m.clock_of in ends:
            change_time_stamp_offset_sigma(cluster, m.clock_of, time_stamp_offset_sigma_s(m, self.settings))
        scatter_m = noise.every.lower_bound_m(0)
        bias = pair_bias(denied, m)
        self._consider_bias(cluster, pair, bias)
        unbiased = m if bias is None else replace(m, range_m=max(m.range_m - bias.mean_m, 0.0))
        white_m = scatter_m if scatter_m > UNDERSTATED * sigma_m else sigma_m
        unknown = unknown_errors(denied, pair)
        result = update_range(cluster, pair, unbiased, white_m, coloured_m, self.considered_m, unknown)
        refused = result.outcome is Outcome.REFUSED_RANGE_GATE
        if refused and [vehicle for vehicle, other, _ in denied if add_missed_turn(cluster, vehicle, other, result, m)]:
            # Models are compared by the first try.
            again = update_range(cluster, pair, unbiased, white_m, coloured_m, self.considered_m, unknown)
            result = result._replace(outcome=again.outcome)
        if not result.used:
            self.pairs[pair] = noise._replace(used=before.used)
        elif len(denied) == 1:
            observe_bias(cluster, *denied[0][:2], m, white_m, coloured_m)
        for denied_vehicle, other, _ in denied:
            decide_unshown_motion(cluster, denied_vehicle, result, m)
            monitor_range(cluster, denied_vehicle, other, result, m)
        return result

    def _consider_bias(self, cluster: Cluster, pair: Key, bias: PairBias | None) -> None:
        """Set the sigma of a pair's bias to what its ranges have shown, eq. (33); no range corrects one found."""
        usual_m = self.settings.range_bias_sigma_m
        before_m, now_m = self.considered_m.get(pair, usual_m), usual_m if bias is None else bias.sigma_m
        if now_m != before_m:
            cluster.change_bias_sigma(pair, before_m, now_m)
        if bias is not None:
            self.considered_m[pair] = now_m
        else:
            self.considered_m.pop(pair, None)

    def _initialise_ends(self, ends: tuple[int, int], m: RangeMeasurement, open_sides: frozenset[int]) -> UpdateResult | None:
        """Initialise ends of a range without states; return what became of the range if it is not used."""
        at_s = m.measured_at_s
        for vehicle, other in (ends, ends[::-1]):
            if vehicle in self.clusters:
                continue
            if self.records[vehicle].denied_vehicle:
                found = initialise_from_ranges(self.clusters, vehicle, at_s, open_sides)
                if not found and begin_by_slow_ranges(self.clusters, vehicle, other, m):
                    return UpdateResult(search_with_range(self.clusters, vehicle, other, m))
                return UpdateResult(Outcome.INITIALISED if found else Outcome.KEPT_INITIALISING)
            if not initialise_from_reports(self.clusters, vehicle, at_s):
                return UpdateResult(Outcome.REFUSED_PEER_WITHOUT_POSITION)
        return None

    def _prune(self, at_s: float) -> None:
        """Remove peers without recent ranges, and denied vehicles that were silent for an hour.

        Clusters are split where no range links their vehicles.
        """
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
                record.no_estimate_reason = Unlocated(NoEstimateReason.SILENT)
        self.clusters.prune(links)
        self.pairs = {key: noise for key, noise in self.pairs.items() if key[1] in links.get(key[0], ())}
        self.considered_m = {key: sigma_m for key, sigma_m in self.considered_m.items() if key in self.pairs}

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return where a vehicle is at a time near that of its states, or why that is unknown."""
        record = self.records.get(vehicle)
        if record is None:
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.NOT_HEARD))
        cluster = self.clusters.get(vehicle)
        if cluster is None:
            if record.search is not None:
                return estimate_of_search(vehicle, record, record.search, at_s, self.settings)
            return self._estimate_without_state(vehicle, record, at_s)
        return estimate_of_cluster(cluster, vehicle, at_s)

    def _estimate_without_state(self, vehicle: int, record: VehicleRecord, at_s: float) -> Estimate | NoEstimate:
        """Estimate a healthy vehicle from its reports; of a denied one return the reason in its record."""
        if record.denied_vehicle or record.last_position is None:
            return NoEstimate(vehicle, at_s, record.no_estimate_reason)
        age_s = at_s - record.last_position.measured_at_s
        if age_s > self.settings.initialisation_age_s and not record.static:
            return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.STALE, age_s))
        alone = FleetModel(self.settings)
        alone.records.copy_from(self.records, vehicle)
        if record.last_position.velocity_enu_mps is not None:
            # Filtering the earlier reports too would hardly change the estimate, and this is called often.
            kept = [m for m in record.own_measurements if m is record.last_position or isinstance(m, AttitudeMeasurement)]
            alone.records[vehicle].own_measurements = tuple(kept)
        initialise_from_reports(alone.clusters, vehicle, at_s)
        return alone.estimate(vehicle, at_s)
