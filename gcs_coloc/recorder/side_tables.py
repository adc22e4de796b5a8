"""The tables beside a recording: ranges that its frames do not carry, and true positions."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.stations.node_id import MAX_SYSTEM_ID
from gcs_coloc.evaluation.tables import TableRow, read_table
from gcs_coloc.mavlink.checks import RANGE_MAX_M
from gcs_coloc.mavlink.decoder import HeardTruth


@dataclass(frozen=True, slots=True)
class TruthPoint:
    """The true position of a vehicle. Degrees, metres above mean sea level, UNIX seconds of the recorder."""

    unix_s: float
    sysid: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float


class TruthTable:
    """True positions, looked up by time."""

    def __init__(self, points: Sequence[TruthPoint]) -> None:
        """`points` are in order of time."""
        self._by_vehicle: dict[int, list[TruthPoint]] = {}
        for point in points:
            self._by_vehicle.setdefault(point.sysid, []).append(point)

    def at(self, unix_s: float) -> dict[int, HeardTruth]:
        """Each vehicle's newest point not after a time (UNIX s), by system id."""
        found = {}
        for sysid, points in self._by_vehicle.items():
            i = bisect_right(points, unix_s, key=lambda point: point.unix_s)
            if i > 0:
                point = points[i - 1]
                found[sysid] = HeardTruth(sysid, point.unix_s, point.lat_deg, point.lon_deg)
        return found


def read_ranges(path: Path | None) -> list[PeerRange]:
    """Return the ranges of a table, in order of time; none where there is no table.

    Its columns are `unix_s,from_sysid,to_sysid,range_m,sigma_m`. `unix_s` is the time of measurement; `sigma_m` may be left out.

    Raises:
        DataError: as `read_table`, or a value is impossible.
    """
    if path is None:
        return []
    ranges = []
    for row in read_table(path, ("unix_s", "from_sysid", "to_sysid", "range_m"), ("sigma_m",)):
        measured_at_s = row.number("unix_s")
        message = PeerRange(
            sysid=row.integer("from_sysid", 1, MAX_SYSTEM_ID),
            received_at_s=measured_at_s,
            peer=row.integer("to_sysid", 1, MAX_SYSTEM_ID),
            range_m=_range_m(row),
            sigma_m=None if row.is_empty("sigma_m") else row.positive("sigma_m"),
            measured_at_s=measured_at_s,
            time_base=TimeBase.SERVICE,
            sequence=None,
            line_of_sight=None,
            device_id=0,
        )
        if message.sysid == message.peer:
            raise row.error("to_sysid", "a vehicle has no range to itself")
        ranges.append(message)
    return sorted(ranges, key=lambda r: r.received_at_s)


def _range_m(row: TableRow) -> float:
    range_m = row.positive("range_m")
    if range_m > RANGE_MAX_M:
        raise row.error("range_m", f"{range_m:g} is beyond {RANGE_MAX_M:g}, as in PEER_RANGE: metres are wanted")
    return range_m


def read_truth(path: Path | None) -> list[TruthPoint]:
    """The true positions of a table `unix_s,sysid,lat_deg,lon_deg,alt_msl_m` in order of time.

    There are none where there is no table.

    Raises:
        DataError: as `read_table`, or the table is empty.
    """
    if path is None:
        return []
    points = [
        TruthPoint(
            unix_s=row.number("unix_s"),
            sysid=row.integer("sysid", 1, MAX_SYSTEM_ID),
            lat_deg=row.within("lat_deg", -90.0, 90.0, "degrees are wanted, latitude before longitude"),
            lon_deg=row.within("lon_deg", -180.0, 360.0, "degrees are wanted"),
            alt_msl_m=row.number("alt_msl_m"),
        )
        for row in read_table(path, ("unix_s", "sysid", "lat_deg", "lon_deg", "alt_msl_m"))
    ]
    if not points:
        raise DataError(f"{path}: holds no true position; a row for each time and vehicle is wanted")
    return sorted(points, key=lambda p: p.unix_s)
