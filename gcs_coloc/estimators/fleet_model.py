"""The fleet as the filter knows it, fed in the order of measuring: who is a subject, in which cluster, and who is used as a peer.

Only vehicles that a subject ranges have states in a filter. Of any other healthy vehicle only a few recent reports are kept,
from which a filter for it is started at the moment when it is needed.
"""

from __future__ import annotations

import math

import numpy as np

from gcs_coloc.core.measurements import (
    AltitudeMeasurement,
    AttitudeMeasurement,
    Estimate,
    FloatArray,
    Measurement,
    PositionMeasurement,
    RangeMeasurement,
    Unknown,
)
from gcs_coloc.estimators.fleet_answer import answer
from gcs_coloc.estimators.fleet_blocks import initial_block, pair_key, start_block
from gcs_coloc.estimators.fleet_cluster import Cluster
from gcs_coloc.estimators.fleet_clusters import Clusters
from gcs_coloc.estimators.fleet_corrections import Verdict, restate_clock, take_altitude, take_attitude, take_position, take_range
from gcs_coloc.estimators.fleet_noise import Whiteness, without_time_error
from gcs_coloc.estimators.fleet_peers import choose_peers
from gcs_coloc.estimators.fleet_settings import FleetSettings
from gcs_coloc.estimators.fleet_start import StartProblem, solve_start
from gcs_coloc.estimators.fleet_vehicle import Neighbour, VehicleRecord

_CHOICE_HOLDS_S = 2.0
_TIDY_EVERY_S = 5.0
_START_EVERY_S = 0.5
_LOST_SHARE = 0.5
_REFUSAL_MEMORY = 10.0
_REPORTS_REFUSED_MOST = 10


class FleetModel:
    """The state of the whole filter. `copy` is an independent copy; everything else changes it in place."""

    def __init__(self, settings: FleetSettings) -> None:
        self.settings = settings
        self.records: dict[int, VehicleRecord] = {}
        self.clusters = Clusters(settings, self.records)
        self.pairs: dict[tuple[int, int, int], Whiteness] = {}
        self._tidied_at_s = -math.inf

    def copy(self) -> FleetModel:
        """Return an independent copy."""
        other = FleetModel(self.settings)
        other.records = {vehicle: record.copy() for vehicle, record in self.records.items()}
        other.clusters = self.clusters.copy(other.records)
        other.pairs = {key: white.copy() for key, white in self.pairs.items()}
        other._tidied_at_s = self._tidied_at_s
        return other

    def take_over(self, other: FleetModel, vehicle: int) -> None:
        """Replace what this model has of the vehicles in a vehicle's cluster by a copy of what another model has of them."""
        members = other.clusters.together_with(vehicle)
        for member in members:
            self.clusters.drop(member)
            self.records[member] = other.records[member].copy()
        self.clusters.adopt(other.clusters[vehicle], members)
        for key, white in other.pairs.items():
            if key[0] in members:
                self.pairs[key] = white.copy()
        self._tidied_at_s = other._tidied_at_s

    def learn(self, other: FleetModel, vehicles: tuple[int, ...]) -> None:
        """Take from another model what it knows of vehicles that are in no cluster of this one."""
        for vehicle in vehicles:
            if vehicle in self.clusters or vehicle not in other.records:
                continue
            self.records[vehicle] = other.records[vehicle].copy()
            if vehicle in other.clusters and not any(v in self.clusters for v in other.clusters.together_with(vehicle)):
                self.take_over(other, vehicle)

    def set_subjects(self, subjects: frozenset[int], at_s: float) -> None:
        """Change who is to be located; a new subject starts from its last reports if these are fresh."""
        for vehicle in sorted(subjects):
            record = self._record(vehicle)
            if record.subject:
                continue
            record.subject = True
            if vehicle not in self.clusters and not self._activate(vehicle, at_s):
                record.reason = "no fresh position to start from, and not enough ranges yet"
        for vehicle, record in self.records.items():
            if record.subject and vehicle not in subjects:
                record.subject = False
                record.ranges = ()
                record.neighbours = {}
                # Its reports are trusted again and start a filter when one is needed.
                self.clusters.drop(vehicle)
                record.recent = ()
                record.last_position = None
                record.reason = "no position report since its GPS was trusted again"

    def apply(self, m: Measurement) -> Verdict:
        """Take one measurement, not older than any before it."""
        if m.measured_at_s - self._tidied_at_s > _TIDY_EVERY_S:
            self._tidy(m.measured_at_s)
        if isinstance(m, RangeMeasurement):
            return self._range(m)
        record = self._record(m.vehicle)
        if isinstance(m, PositionMeasurement):
            return self._position(m, record)
        if isinstance(m, AltitudeMeasurement):
            record.white_baro.add(m.measured_at_s, (m.up_m,), m.sigma_m)
        record.remember(m)
        cluster = self.clusters.get(m.vehicle)
        if cluster is None:
            return Verdict("kept: vehicle has no part in locating a subject")
        return self._own(cluster, m, record)

    def _own(self, cluster: Cluster, m: Measurement, record: VehicleRecord) -> Verdict:
        share = self.settings.least_slow_share
        if isinstance(m, PositionMeasurement):
            sigma_h_m, sigma_v_m = without_time_error(m)
            white_h, slow_h = record.white_h.split(sigma_h_m, share)
            white_v, slow_v = record.white_v.split(sigma_v_m, share)
            return take_position(cluster, m, (white_h, white_v), (slow_h, slow_v), self._stamp_s(m))
        if isinstance(m, AltitudeMeasurement):
            return take_altitude(cluster, m, *record.white_baro.split(m.sigma_m, share))
        assert isinstance(m, AttitudeMeasurement)
        return take_attitude(cluster, m)

    def _stamp_s(self, m: PositionMeasurement | RangeMeasurement) -> float:
        return math.hypot(self.settings.stamp_sigma_s, m.time_sigma_s)

    def _position(self, m: PositionMeasurement, record: VehicleRecord) -> Verdict:
        if record.subject:
            return Verdict("refused: position of a subject")
        record.fixed = m.static
        sigma_h_m, sigma_v_m = without_time_error(m)
        record.white_h.add(m.measured_at_s, m.position_enu_m[:2], sigma_h_m)
        record.white_v.add(m.measured_at_s, m.position_enu_m[2:], sigma_v_m)
        record.remember(m)
        record.last_position = m
        cluster = self.clusters.get(m.vehicle)
        if cluster is None or record.fixed:
            return Verdict("kept: vehicle has no part in locating a subject")
        verdict = self._own(cluster, m, record)
        if verdict.used:
            record.reports_refused = 0
            return verdict
        record.reports_refused += 1
        if record.reports_refused >= _REPORTS_REFUSED_MOST:
            # The reports agree with each other and not with the filter: they are the only witness of this vehicle.
            self.clusters.drop(m.vehicle)
            record.recent = (m,)
            record.reports_refused = 0
            return Verdict("peer restarted: its reports moved away")
        return verdict

    def _range(self, m: RangeMeasurement) -> Verdict:
        ends = (m.from_vehicle, m.to_vehicle)
        records = [self._record(vehicle) for vehicle in ends]
        if not (records[0].subject or records[1].subject):
            return Verdict("kept: range between healthy vehicles")
        for record, other in zip(records, reversed(ends), strict=True):
            if record.subject:
                record.remember_range(m)
                record.heard[other] = m.measured_at_s
                if not self._wanted(record, other, m):
                    return Verdict("kept: better placed peers are used")
        for vehicle, record in zip(ends, records, strict=True):
            if vehicle in self.clusters:
                continue
            if record.subject:
                if not self._start(vehicle, m.measured_at_s):
                    return Verdict("kept: waiting for a start")
                return Verdict("used for a start")
            if not self._activate(vehicle, m.measured_at_s):
                return Verdict("refused: peer without a position")
        cluster = self.clusters.merge(*ends)
        white = self.pairs.setdefault(pair_key(*ends, m.device_id), Whiteness())
        sigma_m, _ = without_time_error(m)
        white.add(m.measured_at_s, (m.range_m,), sigma_m)
        slow_m = self.settings.range_slow_share * white.split(sigma_m, self.settings.least_slow_share)[1]
        if m.clock_of in ends:
            restate_clock(cluster, m.clock_of, self._stamp_s(m))
        verdict = take_range(cluster, m, sigma_m, slow_m)
        for vehicle, other, record in zip(ends, reversed(ends), records, strict=True):
            if record.subject:
                self._account(cluster, vehicle, other, record, verdict, m)
        return verdict

    def _account(
        self,
        cluster: Cluster,
        vehicle: int,
        other: int,
        record: VehicleRecord,
        verdict: Verdict,
        m: RangeMeasurement,
    ) -> None:
        """Note what became of a range at one of its ends, and find the way back when most are refused."""
        if verdict.used:
            d = cluster.place(vehicle) - cluster.place(other)
            e, n, u = (d / max(math.sqrt(float(d @ d)), 1e-9)).tolist()
            record.neighbours[other] = Neighbour(m.measured_at_s, (e, n, u))
            record.informed_at_s = m.measured_at_s
            record.refused_share -= record.refused_share / _REFUSAL_MEMORY
            return
        if verdict.degrees_of_freedom == 0:
            return
        record.refused_share += (1.0 - record.refused_share) / _REFUSAL_MEMORY
        square = verdict.innovation_m**2
        record.refused_m2 = square if record.refused_share <= 1.0 / _REFUSAL_MEMORY else 0.7 * record.refused_m2 + 0.3 * square
        if record.refused_share > _LOST_SHARE:
            # Most of what is heard contradicts the state: the state is what is wrong, or nobody can tell.
            cluster.widen(vehicle, record.refused_m2)
            record.refused_share = 0.0

    def _record(self, vehicle: int) -> VehicleRecord:
        record = self.records.get(vehicle)
        if record is None:
            record = self.records[vehicle] = VehicleRecord()
        return record

    def _activate(self, vehicle: int, at_s: float) -> bool:
        """Start a filter for a vehicle from its recent reports, if these are fresh."""
        record = self.records[vehicle]
        last = record.last_position
        if last is None or (at_s - last.measured_at_s > self.settings.start_age_s and not record.fixed):
            return False
        if record.fixed:
            variances = [last.sigma_h_m**2, last.sigma_h_m**2, last.sigma_v_m**2]
            self.clusters.begin(vehicle, np.array(last.position_enu_m), np.diag(variances), last.measured_at_s)
            return True
        reports = [m for m in record.recent if isinstance(m, PositionMeasurement)]
        first = reports[0] if reports else last
        share = self.settings.least_slow_share
        sigma_h_m, sigma_v_m = without_time_error(first)
        white_h, slow_h = record.white_h.split(sigma_h_m, share)
        white_v, slow_v = record.white_v.split(sigma_v_m, share)
        record.stamp_s = self._stamp_s(first)
        record.slow_report_h_m, record.slow_report_v_m, record.slow_baro_m = slow_h, slow_v, 0.0
        record.attitude = None
        record.informed_at_s = record.velocity_used_at_s = first.measured_at_s
        mean, covariance = initial_block(first, (white_h, white_v), (slow_h, slow_v), record.stamp_s, self.settings)
        cluster = self.clusters.begin(vehicle, mean, covariance, first.measured_at_s)
        for m in record.recent:
            if m is not first and m.measured_at_s >= first.measured_at_s:
                self._own(cluster, m, record)
        return True

    def _tidy(self, at_s: float) -> None:
        """Drop the vehicles that no subject has ranged for long, and part the clusters that nothing holds together any more."""
        self._tidied_at_s = at_s
        kept_s = self.settings.peer_kept_s
        links: dict[int, set[int]] = {}
        for vehicle, record in self.records.items():
            if not record.subject:
                continue
            record.heard = {other: t for other, t in record.heard.items() if at_s - t <= kept_s}
            record.neighbours = {other: n for other, n in record.neighbours.items() if at_s - n.at_s <= kept_s}
            for other in record.neighbours:
                links.setdefault(vehicle, set()).add(other)
                links.setdefault(other, set()).add(vehicle)
        self.clusters.part(links)
        self.pairs = {key: white for key, white in self.pairs.items() if key[1] in links.get(key[0], ())}

    def _wanted(self, record: VehicleRecord, other: int, m: RangeMeasurement) -> bool:
        """Whether a neighbour is among the at most K that a subject uses."""
        most = self.settings.peers_per_subject
        at_s = m.measured_at_s
        if other in record.chosen:
            pass
        elif len(record.heard) <= most:
            record.chosen = frozenset(record.heard)
        if at_s - record.chosen_at_s >= _CHOICE_HOLDS_S:
            record.chosen_at_s = at_s
            fresh = sorted(v for v, t in record.heard.items() if at_s - t <= self.settings.peer_fresh_s)
            if len(fresh) <= most:
                record.chosen = frozenset(fresh)
            else:
                subject = m.from_vehicle if other == m.to_vehicle else m.to_vehicle
                record.chosen = self._choose(subject, record, fresh)
        return other in record.chosen

    def _choose(self, subject: int, record: VehicleRecord, fresh: list[int]) -> frozenset[int]:
        here = self._roughly(subject)
        placed = [(v, there) for v in fresh if (there := self._roughly(v)) is not None]
        if here is None or len(placed) <= self.settings.peers_per_subject:
            return frozenset([v for v, _ in placed][: self.settings.peers_per_subject])
        subjects = {vehicle: other for vehicle, other in self.records.items() if other.subject}
        used = (other.chosen for vehicle, other in subjects.items() if vehicle != subject)
        shared = frozenset().union(*used) - subjects.keys()
        height_known = any(isinstance(m, AltitudeMeasurement) for m in record.recent)
        most = self.settings.peers_per_subject
        return choose_peers(here, placed, record.chosen, shared, most, height_known=height_known)

    def _roughly(self, vehicle: int) -> FloatArray | None:
        cluster, record = self.clusters.get(vehicle), self.records[vehicle]
        if cluster is not None:
            start = cluster.joint.start[vehicle]
            return cluster.joint.x[start : start + 3]
        return np.array(record.last_position.position_enu_m) if record.last_position is not None else None

    def _start(self, vehicle: int, at_s: float) -> bool:
        """Try to find a subject without a position from its recent ranges alone."""
        record = self.records[vehicle]
        if at_s - record.start_tried_at_s < _START_EVERY_S:
            return False
        record.start_tried_at_s = at_s
        outcome = solve_start(self._start_problem(vehicle, at_s), self.settings.limit_sigma_m)
        if isinstance(outcome, str):
            record.reason = outcome
            return False
        record.slow_baro_m = record.slow_report_h_m = record.slow_report_v_m = 0.0
        record.stamp_s = self.settings.stamp_sigma_s
        record.attitude = None
        record.informed_at_s = at_s
        record.ranges = ()
        self.clusters.begin(vehicle, *start_block(*outcome, self.settings), at_s)
        return True

    def _start_problem(self, vehicle: int, at_s: float) -> StartProblem:
        problem = StartProblem(at_s)
        for m in self.records[vehicle].ranges:
            peer = m.to_vehicle if m.from_vehicle == vehicle else m.from_vehicle
            report = self.records[peer].last_position
            if report is None or self.records[peer].subject:
                continue
            past = [r for r in self.records[peer].recent if isinstance(r, PositionMeasurement)]
            near = min(past, key=lambda r: abs(r.measured_at_s - m.measured_at_s), default=report)
            if abs(near.measured_at_s - m.measured_at_s) > self.settings.start_age_s and not near.static:
                continue
            problem.add_range(peer, near, past, m)
        for own in self.records[vehicle].recent:
            if isinstance(own, AltitudeMeasurement):
                problem.add_altitude(own)
        return problem

    def estimate(self, vehicle: int, at_s: float) -> Estimate | Unknown:
        """Answer from the state as it stands."""
        record = self.records.get(vehicle)
        if record is None:
            return Unknown(vehicle, at_s, "no measurement of it was heard")
        cluster = self.clusters.get(vehicle)
        if cluster is None:
            return self._idle(vehicle, record, at_s)
        return answer(cluster, vehicle, at_s)

    def _idle(self, vehicle: int, record: VehicleRecord, at_s: float) -> Estimate | Unknown:
        """Answer for a vehicle that has no filter: a healthy one from its own reports, a subject with the reason why not."""
        if record.subject or record.last_position is None:
            return Unknown(vehicle, at_s, record.reason)
        age_s = at_s - record.last_position.measured_at_s
        if age_s > self.settings.start_age_s and not record.fixed:
            return Unknown(vehicle, at_s, f"no position report for {age_s:.0f} s")
        alone = FleetModel(self.settings)
        own = alone.records[vehicle] = record.copy()
        if record.last_position.velocity_enu_mps is not None:
            # Its last report has all that a filter over the others would tell; this is asked often.
            own.recent = ()
        alone._activate(vehicle, at_s)
        return alone.estimate(vehicle, at_s)
