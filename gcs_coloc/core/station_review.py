"""The review of a fleet's stations: hands on where they are, and what is found of them."""

from __future__ import annotations

from dataclasses import dataclass

from gcs_coloc.core.dispatch import Stages
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.evidence import PositionFault
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.integrity.report import IntegrityReport, ReviewedVehicle
from gcs_coloc.core.measurements import Vector3
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.stations.node_id import node_name, station_id_of
from gcs_coloc.core.stations.station_survey import survey_notice, surveyed_station
from gcs_coloc.core.stations.stations import Station, StationPosition

_ORIGIN_AFTER_S = 10.0  # chosen: a vehicle with GPS is healthy, and sets the fleet's origin, within so long after it is heard


# Not frozen, as `VehicleSnapshot` is not: it is built many times a second.
@dataclass(slots=True)
class StationSnapshot:
    """One station as the service sees it. Degrees, metres above mean sea level; None where unknown.

    `node` is its node id, as ranges have it. `sigma_h_m`, `sigma_v_m` are 1-sigma per axis, `enu_m` its place in the fleet's
    frame. `source` says where its position comes from, `range_age_s` how old the newest range to it is. `fault` says in words
    that ranges contradict its position; `is_used` whether ranges to it locate vehicles.
    """

    station_id: int
    node: int
    name: str
    source: str
    lat_deg: float | None
    lon_deg: float | None
    alt_msl_m: float | None
    sigma_h_m: float | None
    sigma_v_m: float | None
    enu_m: Vector3 | None
    range_age_s: float | None
    fault: str | None
    is_used: bool


class StationReview:
    """Hands the stations on to the stages that use them, and tells what is found of them."""

    def __init__(self, stages: Stages) -> None:
        self._stages = stages
        self._given: dict[int, StationPosition] = {}

    def witnesses(self, now_s: float) -> list[ReviewedVehicle]:
        """Return the stations as a review of integrity takes them.

        A position that is new goes to the estimator. Where no vehicle has set the fleet's origin in time, a station does.
        """
        s = self._stages
        first_ranged_s = s.stations.first_ranged_s
        if s.measurements.frame is None and first_ranged_s is not None and now_s - first_ranged_s >= _ORIGIN_AFTER_S:
            s.measurements.set_origin(next(station for station in s.stations if station.position is not None))
        frame = s.measurements.frame
        if frame is None:
            return []
        return [self._reviewed(station, frame, now_s) for station in s.stations if station.position is not None]

    def update(self, before: IntegrityReport, report: IntegrityReport, now_s: float) -> list[Notice]:
        """Seek a station; return what the operator must know of that, and of two reports in a row."""
        out = []
        for station in self._stages.stations:
            was, now = before.faults.get(station.node), report.faults.get(station.node)
            was_wrong = was is not None and was.is_identified
            if now is not None and now.is_identified:
                if not was_wrong:
                    text = f"{station.label}: {_wording(now)}. Its ranges are not used until they fit"
                    out.append(Notice(now_s, None, "error", text))
            elif was_wrong:
                out.append(Notice(now_s, None, "info", f"{station.label}: ranges fit its position again"))
        return [*out, *self._seek(now_s)]

    def _seek(self, now_s: float) -> list[Notice]:
        """Seek one station without position; return where it is, or why it is not found, where that is new."""
        s, frame = self._stages, self._stages.measurements.frame
        if frame is None or (sought := s.survey.solve_next()) is None:
            return []
        node, found = sought
        return [] if s.stations.is_placed(node) else [survey_notice(self._unplaced(node), found, frame, now_s)]

    def _unplaced(self, node: int) -> Station:
        return self._stages.stations.get(node) or Station(station_id_of(node))

    def snapshots(self, report: IntegrityReport, now_s: float) -> tuple[StationSnapshot, ...]:
        """Return the stations for observers."""
        stations = [*self._stages.stations, *self._surveyed()]
        return tuple(self._snapshot(station, report.faults.get(station.node), now_s) for station in stations)

    def _surveyed(self) -> list[Station]:
        """Return the stations that have no position but the one that was found."""
        s, frame = self._stages, self._stages.measurements.frame
        if frame is None:
            return []
        found = ((node, at) for node, at in s.survey.found.items() if not s.stations.is_placed(node))
        return [surveyed_station(self._unplaced(node), at, frame) for node, at in found]

    def _reviewed(self, station: Station, frame: LocalFrame, now_s: float) -> ReviewedVehicle:
        s, node = self._stages, station.node
        reported = station.measurement(frame, now_s)
        assert reported is not None
        assert station.position is not None
        if self._given.get(node) != station.position:
            self._given[node] = station.position
            s.estimator.add(reported)
        is_wrong = s.integrity.has_identified(node)
        if not is_wrong:
            s.integrity.add_position(reported)
        return ReviewedVehicle(
            node,
            GpsState.FAILED if is_wrong else GpsState.HEALTHY,
            is_trusted=not is_wrong,
            is_witness=not is_wrong,
            is_automatic=True,
            reported=reported,
            receiver_fix=reported if is_wrong else None,
        )

    def _snapshot(self, station: Station, fault: PositionFault | None, now_s: float) -> StationSnapshot:
        s, at = self._stages, station.position
        frame = s.measurements.frame
        where = station.measurement(frame, now_s) if frame is not None else None
        ranged_s = s.stations.ranged_s(station.node)
        return StationSnapshot(
            station_id=station.station_id,
            node=station.node,
            name=station.name,
            source=station.source.value,
            lat_deg=at.lat_deg if at is not None else None,
            lon_deg=at.lon_deg if at is not None else None,
            alt_msl_m=at.alt_msl_m if at is not None else None,
            sigma_h_m=at.sigma_h_m if at is not None else None,
            sigma_v_m=at.sigma_v_m if at is not None else None,
            enu_m=where.position_enu_m if where is not None else None,
            range_age_s=now_s - ranged_s if ranged_s is not None else None,
            fault=_wording(fault) if fault is not None else None,
            is_used=s.stations.is_placed(station.node) and (fault is None or not fault.is_identified),
        )


def _wording(fault: PositionFault) -> str:
    others = ", ".join(map(node_name, fault.others)) or "its vehicles"
    if fault.is_identified:
        return f"the ranges to {others} put it {fault.size_m:.0f} m from its stated position: correct that"
    return f"positions and ranges contradict each other; the fault is in it or in {others}"
