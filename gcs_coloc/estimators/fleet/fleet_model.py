"""The fleet as one filter knows it: records of all vehicles, clusters with states, updates in the order of measuring.

Only vehicles that a denied vehicle ranges have states. Of any other healthy vehicle only a few recent reports are kept, from
which its states are initialised when a range needs them.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.error_ellipse import horizontal_sigma_m
from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    Estimate,
    FloatArray,
    Measurement,
    NoEstimate,
    PositionMeasurement,
    RangeMeasurement,
    VehicleClassReport,
)
from gcs_coloc.estimators.fleet.ekf.adaptive_noise import NO_SAMPLES, ManoeuvreDetector, NoiseSplit, without_time_error
from gcs_coloc.estimators.fleet.ekf.cluster import Cluster, ClusterSet
from gcs_coloc.estimators.fleet.ekf.outcomes import Outcome, UpdateResult
from gcs_coloc.estimators.fleet.ekf.process_model import gap_covariance
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S, Neighbour, Records, VehicleRecord
from gcs_coloc.estimators.fleet.ekf.state import POSITION, SIZE, TIME_STAMP_OFFSET, VELOCITY, pair_key
from gcs_coloc.estimators.fleet.ekf.update import (
    change_time_stamp_offset_sigma,
    time_stamp_offset_sigma_s,
    update_own,
    update_range,
)
from gcs_coloc.estimators.fleet.initialisation import initialise_from_ranges, initialise_from_reports
from gcs_coloc.estimators.fleet.motion_profiles import MotionProfile, motion_profile
from gcs_coloc.estimators.fleet.peer_selection import is_selected
from gcs_coloc.estimators.fleet.position_search import PositionSearch, RangeCircle, is_too_wide
from gcs_coloc.estimators.fleet.range_evidence import monitor_range, unresolved_outlier_variance_m2
from gcs_coloc.estimators.fleet.settings import FleetSettings
from gcs_coloc.estimators.qu_zhang.dop import horizontal_dilution_of

_PRUNE_EVERY_S = 5.0
"""Chosen: pruning walks over all vehicles."""
_REPORTS_REFUSED_MOST = 10
"""Chosen: reports refused in a row agree with each other, not with the filter: a second at 10 Hz."""
_UNDERSTATED = 1.8
"""Observed scatter over stated sigma from which on a device counts as optimistic: multipath of a tenth of the ranges, which the
gate weighs one by one, looks like up to 1.8 times the noise."""
_SILENT_MOST_S = 3600.0
"""Chosen: a state without updates for longer carries no information; growing for a month it would lose its digits."""
_STEP_BACK_MOST_S = 2.0
"""Chosen: further back the prediction with negative steps does not hold."""
_STATED = np.eye(6, SIZE)
"""Position and velocity of a vehicle's block."""


class FleetModel:
    """Records and clusters of one fleet. All methods but `copy` and `estimate` change it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.settings = settings
        self.records = Records(unreported=motion_profile(None, settings))
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
        """Replace the vehicles of one vehicle's cluster by copies of those in another model."""
        members = other.clusters.members(vehicle)
        for member in members:
            self.clusters.remove(member)
            self._copy_record(other, member)
        self.clusters.add_copy(other.clusters[vehicle], members)
        for key, noise in other.pairs.items():
            if key[0] in members:
                self.pairs[key] = noise
        self._pruned_at_s = other._pruned_at_s

    def import_vehicles(self, other: FleetModel, vehicles: tuple[int, ...]) -> None:
        """Copy from another model the vehicles that are in no cluster of this one, with their clusters where possible."""
        for vehicle in vehicles:
            if vehicle in self.clusters or vehicle not in other.records:
                continue
            self._copy_record(other, vehicle)
            if vehicle in other.clusters and not any(v in self.clusters for v in other.clusters.members(vehicle)):
                self.replace_from(other, vehicle)

    def _copy_record(self, other: FleetModel, vehicle: int) -> None:
        """Copy a vehicle's record from another model; those of vehicles that it has ranged must exist for the peer selection."""
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
            if vehicle not in self.clusters and not self._initialise(vehicle, at_s):
                record.no_estimate_reason = "no fresh position to start from, and not enough ranges yet"
        for vehicle in [v for v, record in self.records.items() if record.denied_vehicle and v not in denied]:
            record = self.records.writable(vehicle)
            record.denied_vehicle = False
            record.range_measurements = ()
            record.search = None
            record.neighbours = {}
            # Its new reports initialise its states when a range needs them; the old ones are not to be trusted.
            self.clusters.remove(vehicle)
            record.own_measurements = ()
            record.last_position = None
            record.no_estimate_reason = "no position report since its GPS was trusted again"

    def apply(self, m: Measurement) -> UpdateResult:
        """Update with one measurement, not older than any before it."""
        if m.measured_at_s - self._pruned_at_s > _PRUNE_EVERY_S:
            self._prune(m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            return self._update_range(m)
        record = self.records.writable(m.vehicle)
        if isinstance(m, VehicleClassReport):
            record.profile = motion_profile(m.vehicle_class, self.settings)
            return UpdateResult(Outcome.CLASS_REPORTED)
        if isinstance(m, PositionMeasurement):
            return self._update_position(m, record)
        if isinstance(m, AltitudeMeasurement):
            record.altitude_noise = record.altitude_noise.updated(m.measured_at_s, ((m.up_m,),), (m.sigma_m,))
        record.add_own(m)
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.static:
            if record.search is not None and isinstance(m, AltitudeMeasurement):
                record.search = self._predicted_search(record.search, record.profile, m.measured_at_s).with_height(
                    m.up_m, m.sigma_m**2
                )
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
        record.last_position = m
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.static:
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

    def _update_range(self, m: RangeMeasurement) -> UpdateResult:
        ends = (m.from_vehicle, m.to_vehicle)
        first, second = self.records.writable(ends[0]), self.records.writable(ends[1])
        denied = [(*ends, first)] if first.denied_vehicle else []
        if second.denied_vehicle:
            denied.append((*ends[::-1], second))
        if not denied:
            return UpdateResult(Outcome.KEPT_NOT_DENIED)
        for denied_vehicle, other, record in denied:
            record.add_range(m)
            record.last_range_s[other] = m.measured_at_s
            if not is_selected(self.clusters, self.records, denied_vehicle, other, m.measured_at_s, self.settings):
                return UpdateResult(Outcome.KEPT_NOT_SELECTED)
        searching = [self._is_searching(vehicle, other, m) for vehicle, other, _ in denied]
        if any(searching):
            outcomes = [self._search(*denied[i][:2], m) for i, wanted in enumerate(searching) if wanted]
            return UpdateResult(outcomes[0])
        cluster = self.clusters.common(*ends)
        if cluster is None:
            waiting = self._initialise_ends(ends, m.measured_at_s)
            if waiting is not None:
                return waiting
            cluster = self.clusters.merge(*ends)
        pair = pair_key(*ends, m.device_id)
        sigma_m, _ = without_time_error(m)
        noise = self.pairs.get(pair, NO_SAMPLES).updated(m.measured_at_s, ((m.range_m,),), (sigma_m,))
        self.pairs[pair] = noise
        coloured_m = self.settings.range_coloured_share * noise.split(0, sigma_m, self.settings.least_coloured_share)[1]
        if m.clock_of in ends:
            change_time_stamp_offset_sigma(cluster, m.clock_of, time_stamp_offset_sigma_s(m, self.settings))
        scatter_m = noise.lower_bound_m(0)
        result = update_range(cluster, pair, m, scatter_m if scatter_m > _UNDERSTATED * sigma_m else sigma_m, coloured_m)
        for denied_vehicle, other, _ in denied:
            monitor_range(cluster, denied_vehicle, other, result, m)
        return result

    def _is_searching(self, vehicle: int, other: int, m: RangeMeasurement) -> bool:
        """Whether a denied vehicle is searched, also from this range on: it is too uncertain to linearise it."""
        record, cluster = self.records[vehicle], self.clusters.get(vehicle)
        if cluster is None:
            return record.search is not None
        cluster.add_gap(vehicle, m.measured_at_s)
        P, record = cluster.joint.covariance(vehicle), self.records[vehicle]
        if not is_too_wide(P.item(0, 0) + P.item(1, 1), m.range_m, m.sigma_m):
            return False
        there = self._locate_peer(other, m.measured_at_s)
        if there is None:
            return False
        # What a peer's own error adds to a range is no reason to search.
        sigma_m = math.sqrt(m.sigma_m**2 + float(np.trace(there[1])) / 3.0)
        x, P = cluster.predict(vehicle, m.measured_at_s)
        if not is_too_wide(P.item(0, 0) + P.item(1, 1), m.range_m, sigma_m):
            return False
        record.search = PositionSearch.of_state(x, P, m.measured_at_s)
        self.clusters.remove(vehicle)
        return True

    def _search(self, vehicle: int, other: int, m: RangeMeasurement) -> Outcome:
        """Update the search of a denied vehicle with a range; with one place left its states are initialised there."""
        record, at_s = self.records[vehicle], m.measured_at_s
        assert record.search is not None
        there = self._locate_peer(other, at_s)
        if there is None:
            return Outcome.KEPT_INITIALISING
        search = self._predicted_search(record.search, record.profile, at_s)
        search = record.search = search.with_range(RangeCircle(other, *there, m.range_m, m.sigma_m**2))
        if search.is_lost:
            record.search, record.no_estimate_reason = None, "the ranges contradict each other: no place fits them"
            return Outcome.KEPT_INITIALISING
        record.neighbours[other] = Neighbour(at_s, (0.0, 0.0, 0.0))
        settled = search.settled(m.range_m, math.sqrt(m.sigma_m**2 + float(np.trace(there[1])) / 3.0))
        if settled is None:
            return Outcome.SEARCHING
        self.clusters.initialise(vehicle, *settled, at_s)
        record.search, record.cusum, record.unresolved_outlier, record.attitude = None, 0.0, None, None
        record.manoeuvre = ManoeuvreDetector()
        record.range_noise_inflation_m2, record.updated_at_s = 0.0, at_s
        return Outcome.INITIALISED

    def _predicted_search(self, search: PositionSearch, profile: MotionProfile, at_s: float) -> PositionSearch:
        s = self.settings
        densities = s.low_speed_density_m2ps3, s.unobserved_climb_density_m2ps3
        return search.predicted(at_s, densities, (0.5 * profile.max_speed_mps, profile.max_climb_mps))

    def _locate_peer(self, vehicle: int, at_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Return position (3,) and covariance (3, 3) of a peer by its states, None where it has none."""
        if vehicle not in self.clusters and (self.records[vehicle].denied_vehicle or not self._initialise(vehicle, at_s)):
            return None
        cluster = self.clusters[vehicle]
        if self.records[vehicle].static:
            return cluster.joint.mean(vehicle).copy(), cluster.joint.covariance(vehicle).copy()
        x, P = cluster.predict(vehicle, at_s)
        return x[POSITION].copy(), P[POSITION, POSITION].copy()

    def _initialise_ends(self, ends: tuple[int, int], at_s: float) -> UpdateResult | None:
        """Initialise those ends of a range that have no states; return what became of the range where it is not used."""
        for vehicle in ends:
            if vehicle in self.clusters:
                continue
            if self.records[vehicle].denied_vehicle:
                found = initialise_from_ranges(self.clusters, self.records, vehicle, at_s, self.settings)
                return UpdateResult(Outcome.INITIALISED if found else Outcome.KEPT_INITIALISING)
            if not self._initialise(vehicle, at_s):
                return UpdateResult(Outcome.REFUSED_PEER_WITHOUT_POSITION)
        return None

    def _initialise(self, vehicle: int, at_s: float) -> bool:
        return initialise_from_reports(self.clusters, self.records, vehicle, at_s, self.settings)

    def _prune(self, at_s: float) -> None:
        """Remove peers without recent ranges and vehicles silent for an hour; marginalise clusters that no range links."""
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
        self.pairs = {key: noise for key, noise in self.pairs.items() if key[1] in links.get(key[0], ())}

    def estimate(self, vehicle: int, at_s: float) -> Estimate | NoEstimate:
        """Return where a vehicle is at a time near that of its states, or why that is unknown."""
        record = self.records.get(vehicle)
        if record is None:
            return NoEstimate(vehicle, at_s, "no measurement of it was heard")
        cluster = self.clusters.get(vehicle)
        if cluster is None:
            if record.search is not None:
                return self._estimate_of_search(vehicle, record, record.search, at_s)
            return self._estimate_without_state(vehicle, record, at_s)
        return _estimate(cluster, vehicle, at_s)

    def _estimate_of_search(
        self, vehicle: int, record: VehicleRecord, search: PositionSearch, at_s: float
    ) -> Estimate | NoEstimate:
        """Estimate a denied vehicle that is searched, where all places that fit are one."""
        place = self._predicted_search(search, record.profile, at_s).place()
        if place is None:
            return NoEstimate(vehicle, at_s, f"ambiguous: {len(search.mean)} places fit the ranges")
        mean, covariance = place
        worst_m = horizontal_sigma_m(covariance)
        if not worst_m <= self.settings.limit_sigma_m:
            return NoEstimate(vehicle, at_s, _too_uncertain(worst_m))
        return Estimate(vehicle, at_s, mean[:3], mean[3:], covariance, None, len(record.neighbours))

    def _estimate_without_state(self, vehicle: int, record: VehicleRecord, at_s: float) -> Estimate | NoEstimate:
        """Estimate a healthy vehicle from its own reports; of a denied one return the reason why there is none."""
        if record.denied_vehicle or record.last_position is None:
            return NoEstimate(vehicle, at_s, record.no_estimate_reason)
        age_s = at_s - record.last_position.measured_at_s
        if age_s > self.settings.initialisation_age_s and not record.static:
            return NoEstimate(vehicle, at_s, f"no position report for {age_s:.0f} s")
        alone = FleetModel(self.settings)
        alone.records.copy_from(self.records, vehicle)
        if record.last_position.velocity_enu_mps is not None:
            # Filtering the earlier reports too would hardly change the estimate, and this is called often.
            alone.records[vehicle].own_measurements = ()
        alone._initialise(vehicle, at_s)
        return alone.estimate(vehicle, at_s)


def _estimate(cluster: Cluster, vehicle: int, at_s: float) -> Estimate | NoEstimate:
    """Estimate a vehicle of a cluster on the service's clock, eq. (10): p - tau v with its covariance."""
    record = cluster.records[vehicle]
    if record.static:
        covariance = np.diag([0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6])
        covariance[:3, :3] = cluster.joint.covariance(vehicle)
        return Estimate(vehicle, at_s, cluster.joint.mean(vehicle).copy(), np.zeros(3), covariance, None, 0)
    step_s = at_s - cluster.joint.time_s[vehicle]
    if step_s < -_STEP_BACK_MOST_S:
        return NoEstimate(vehicle, at_s, f"asked for a time {-step_s:.1f} s before its newest measurement")
    x, P = cluster.predict(vehicle, at_s)
    offset_s = x.item(TIME_STAMP_OFFSET)
    G = _STATED.copy()
    G[0, 3] = G[1, 4] = G[2, 5] = -offset_s
    G[POSITION, TIME_STAMP_OFFSET] = -x[VELOCITY]
    position, spread = x[POSITION] - offset_s * x[VELOCITY], G @ P @ G.T
    covariance = spread + spread.T
    covariance *= 0.5
    gap_m2, gap_m2ps2, gap_both = gap_covariance(record, cluster.settings, at_s)
    added_m2 = gap_m2 + unresolved_outlier_variance_m2(record)
    for axis in (0, 1):
        covariance[axis, axis] += added_m2
        covariance[axis + 3, axis + 3] += gap_m2ps2
        covariance[axis, axis + 3] += gap_both
        covariance[axis + 3, axis] += gap_both
    worst_m = horizontal_sigma_m(covariance)
    if not worst_m <= cluster.settings.limit_sigma_m:
        return NoEstimate(vehicle, at_s, _too_uncertain(worst_m))
    units = [n.unit for n in record.neighbours.values() if abs(at_s - n.at_s) <= IN_USE_S]
    hdop = horizontal_dilution_of(units) if len(units) >= 2 else None
    return Estimate(vehicle, at_s, position, x[VELOCITY].copy(), covariance, hdop, len(units))


def _too_uncertain(worst_m: float) -> str:
    return f"too uncertain: {worst_m:.0f} m (1-sigma) horizontally; more or better placed ranges are needed"
