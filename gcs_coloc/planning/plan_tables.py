"""The assessment of a plan as data: JSON with the summary, CSV with every step, GeoJSON with the ways."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from gcs_coloc.core.stations.node_id import node_name
from gcs_coloc.planning.assessment import Assessment, Outlook
from gcs_coloc.planning.improvement import Improvement

_COLUMNS = (
    "denied", "sysid", "t_s", "lat_deg", "lon_deg", "alt_msl_m", "hdop", "bound_95_m", "hpl_m", "ranged", "told", "fix", "limit",
)  # fmt: skip


def as_dict(assessed: Assessment, improvement: Improvement | None) -> dict[str, Any]:
    """Return the summary: of each vehicle, and each pair, what is predicted; what was assumed and skipped."""
    plan = assessed.plan
    return {
        "vehicles": [_summary(each, plan.vehicle(each.predicted.sysid).name) for each in assessed.singles],
        "pairs": [_summary(each, plan.vehicle(each.predicted.sysid).name) for each in assessed.pairs],
        "least_share_with_fix": assessed.least_share,
        "improvement": _improvement(improvement) if improvement is not None else None,
        "assumptions": {name: getattr(plan.assumptions, name) for name in type(plan.assumptions).__dataclass_fields__},
        "stations": [
            {"id": s.station_id, "place": list(_geodetic(assessed, s.position_enu_m)), "sigma_m": s.sigma_m}
            for s in plan.stations
        ],
        "remarks": list(plan.remarks),
    }


def write_csv(assessed: Assessment, path: Path) -> None:
    """Write every step of every prediction as CSV; what is not known is empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_COLUMNS)
        for each in (*assessed.singles, *assessed.pairs):
            writer.writerows(_rows(assessed, each))


def write_geojson(assessed: Assessment, path: Path) -> None:
    """Write the ways as lines, cut where a fix begins or ends, and the stations as points (RFC 7946)."""
    features = [feature for each in assessed.singles for feature in _lines(assessed, each)]
    for station in assessed.plan.stations:
        lat, lon, alt = _geodetic(assessed, station.position_enu_m)
        place = {"type": "Point", "coordinates": [lon, lat, alt]}
        features.append({"type": "Feature", "geometry": place, "properties": {"station": station.station_id}})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False), encoding="utf-8")


def _summary(each: Outlook, name: str) -> dict[str, Any]:
    predicted, worst = each.predicted, each.worst
    found: dict[str, Any] = {
        "sysid": predicted.sysid,
        "name": name,
        "denied": list(predicted.denied),
        "flight_s": float(predicted.at_s[-1] - predicted.at_s[0]) if len(predicted.at_s) else 0.0,
        "share_with_fix": predicted.share_with_fix,
        "share_not_told": each.cannot_tell,
        "median_bound_95_m": _finite(each.median_bound_95_m),
        "median_hpl_m": _finite(each.median_hpl_m),
        "worst": None,
    }
    if worst is not None:
        found["worst"] = {
            "from_s": worst.from_s, "until_s": worst.until_s, "has_fix": worst.has_fix, "hpl_m": _finite(worst.hpl_m),
            "cause": worst.cause, "code": worst.code,
        }  # fmt: skip
    return found


def _improvement(found: Improvement) -> dict[str, Any]:
    return {
        "sysid": found.sysid,
        "kind": found.change.kind.value,
        "text": found.text,
        "share_with_fix": [found.before.predicted.share_with_fix, found.after.predicted.share_with_fix],
        "median_hpl_m": [_finite(found.before.median_hpl_m), _finite(found.after.median_hpl_m)],
    }


def _rows(assessed: Assessment, each: Outlook) -> Iterator[list[Any]]:
    p = each.predicted
    is_told = p.is_told
    denied = " ".join(node_name(node) for node in p.denied)
    for k, at_s in enumerate(p.at_s.tolist()):
        lat, lon, alt = _geodetic(assessed, p.position_enu_m[k])
        numbers = ("" if not math.isfinite(v) else f"{v:.2f}" for v in (p.hdop[k], p.bound_95_m[k], p.hpl_m[k]))
        fix = int(p.has_fix[k])
        yield [
            denied,
            p.sysid,
            f"{at_s:.1f}",
            f"{lat:.7f}",
            f"{lon:.7f}",
            f"{alt:.1f}",
            *numbers,
            int(p.ranged[k]),
            int(is_told[k]),
            fix,
            p.limit[k],
        ]


def _lines(assessed: Assessment, each: Outlook) -> Iterator[dict[str, Any]]:
    p = each.predicted
    steps = range(len(p.at_s))
    for (has_fix, code), several in groupby(steps, key=lambda k: (bool(p.has_fix[k]), p.limit_code[k])):
        run = list(several)
        until = min(run[-1] + 1, len(p.at_s) - 1)
        line = [_lon_lat(assessed, p.position_enu_m[k]) for k in (*run, until)]
        properties = {
            "sysid": p.sysid, "fix": has_fix, "limit": p.limit[run[0]], "code": code,
            "from_s": float(p.at_s[run[0]]), "until_s": float(p.at_s[until]),
        }  # fmt: skip
        yield {"type": "Feature", "geometry": {"type": "LineString", "coordinates": line}, "properties": properties}


def _geodetic(assessed: Assessment, place: Any) -> tuple[float, float, float]:
    east, north, up = (float(x) for x in place)
    return assessed.plan.frame.geodetic_from_enu(east, north, up)


def _lon_lat(assessed: Assessment, place: Any) -> list[float]:
    lat, lon, alt = _geodetic(assessed, place)
    return [round(lon, 7), round(lat, 7), round(alt, 1)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
