"""The report of a flight as one HTML page: GPS failures, accuracy, refused messages, plots.

The page loads nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from html import escape
from statistics import median
from typing import Any

import numpy as np

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState
from gcs_coloc.core.reasons import counted
from gcs_coloc.recorder.flight_history import WITHOUT_GPS, FlightHistory
from gcs_coloc.recorder.html_page import Ink, document, picture, table
from gcs_coloc.recorder.journal import EVERY_S, VehicleEntry

_MAX_NOTICES = 500  # chosen: more than anyone reads


def page(history: FlightHistory) -> str:
    """The page as text.

    Raises:
        UsageError: matplotlib is not installed.
    """
    results = history.report.as_dict()
    title = f"Flight {history.file.name}"
    parts = [_summary(history, results)]
    located = {sysid: [e for e in track if e.vehicle.lat_deg is not None] for sysid, track in history.tracks.items()}
    if (frame := history.frame) is not None and any(located.values()):
        origin = f"{frame.lat_deg:.7f}, {frame.lon_deg:.7f}"
        draw = partial(_draw_map, frame=frame, located=located)
        parts.append(picture("Map of the tracks, east over north", draw))
        parts.append(f"<p>East and north of {origin}, where the fleet's first fix was, as on the live page's map.</p>")
    parts.append("<h2>GPS failures</h2>" + _readiness(history) + _health(history))
    for vehicle in results["vehicles"]:
        track = history.tracks.get(vehicle["sysid"], [])
        if any(entry.vehicle.gps_state in WITHOUT_GPS for entry in track):
            parts.append(_vehicle(history, vehicle, track))
    parts.append("<h2>Refused</h2>" + _counts("by the service", results["refused"]))
    parts.append(_counts("on the wire, frames not used", history.counts.wire))
    parts.append(_counts("by the estimator, with those used", results["estimator_counts"]))
    parts.append("<h2>Messages to the operator</h2>" + _notices(history))
    return document(title, parts)


def _summary(history: FlightHistory, results: Mapping[str, Any]) -> str:
    counts = history.counts
    begun = datetime.fromtimestamp(counts.first_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    fleet = f"{counted(len(results['vehicles']), 'vehicle')}, estimator {escape(history.estimator)}"
    lines = [f"{begun}, {counts.last_s - counts.first_s:.1f} s, {counts.records} frames, {fleet}."]
    lines.extend(f'<span class="bad">The file is damaged: {_spaced(kind)}: {n}.</span>' for kind, n in history.damage.items())
    lines.extend(f'<span class="bad">The data do not agree: {escape(finding.text)}</span>' for finding in history.findings)
    lines.append("Everything here was computed again from the recorded frames; all times are seconds since the first of them.")
    return "".join(f"<p>{line}</p>" for line in lines)


def _readiness(history: FlightHistory) -> str:
    """One line of readiness.

    How long healthy vehicles would have been located if their GPS had failed, and what limited it.
    """
    told = [
        entry.vehicle.readiness for track in history.tracks.values() for entry in track if entry.vehicle.readiness is not None
    ]
    if not told:
        return ""
    counts = Counter(each.state for each in told)
    shares = ", ".join(f"{_spaced(state.value)} {counts[state] / len(told):.0%}" for state in ReadinessState if counts[state])
    limits = Counter(each.reason for each in told if each.reason is not None)
    limit = ""
    if limits:
        (reason, _), *_ = limits.most_common(1)
        limit = f"; limited most often by: {escape(next(each.text for each in told if each.reason == reason))}"
    return f"<p>Readiness of healthy vehicles if their GPS had failed, of all their time: {shares}{limit}.</p>"


def _health(history: FlightHistory) -> str:
    rows = (
        (f"{change.at_s - history.counts.first_s:.1f}", str(change.sysid), change.before, change.after, change.reason)
        for change in history.health
    )
    return table("GPS failures", ("s", "vehicle", "GPS was", "became", "because"), rows, numbers=(0, 1))


def _vehicle(history: FlightHistory, vehicle: Mapping[str, Any], track: Sequence[VehicleEntry]) -> str:
    sysid = vehicle["sysid"]
    without = [entry.vehicle for entry in track if entry.vehicle.gps_state in WITHOUT_GPS]
    located = [v for v in without if v.lat_deg is not None]
    rows = [
        ("without its GPS", f"{len(without) * EVERY_S:.1f} s"),
        ("located in that time", f"{len(located) / len(without):.1%}"),
        ("GPS_INPUT with a fix", str(vehicle["gps_input"]["fix"])),
        ("GPS_INPUT without a fix", str(vehicle["gps_input"]["no_fix"])),
    ]
    other_methods = (("external position estimates", "external_positions"), ("positions to PX4", "global_positions"))
    rows.extend((name, str(vehicle[key])) for name, key in other_methods if vehicle[key])
    bounds = [v.bound_95_m for v in located if v.bound_95_m is not None]
    if bounds:
        rows.append(("95 % bound, median and most", f"{median(bounds):.1f} m, {max(bounds):.1f} m"))
    levels = [v.hpl_m for v in located if v.hpl_m is not None]
    if levels:
        rows.append(("protection level, median and most", f"{median(levels):.1f} m, {max(levels):.1f} m"))
    rows.extend(_score(vehicle["score"]))
    times = Counter(v.no_estimate_code for v in without if v.no_estimate_code is not None)
    first = {v.no_estimate_code: v.no_estimate_reason or "" for v in reversed(without)}
    rows.extend((f"not located for {many * EVERY_S:.1f} s", first[code]) for code, many in times.most_common())
    alt = f"Vehicle {sysid} over time: bound and sigma, HDOP and ranges in use, NIS"
    title = f"Vehicle {sysid} without its GPS"
    draw = partial(_draw_vehicle, history=history, track=track)
    return f"<h2>{title}</h2>" + table(title, ("", ""), rows) + picture(alt, draw)


def _score(score: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    if score is None or score["horizontal"] is None:
        return []
    error = score["horizontal"]
    errors = f"{error['rmse_m']:.2f} m, {error['p95_m']:.2f} m, {error['max_m']:.2f} m"
    return [
        ("horizontal error against the truth: RMSE, 95 %, most", errors),
        ("95 % bound covers", f"{score['covered_95']:.1%}"),
        ("error beyond three times the bound", f"{score['beyond_three_bounds']:.2%}"),
    ]


def _counts(what: str, counts: Mapping[str, int]) -> str:
    if not counts:
        return f"<p>Nothing {escape(what.split(',')[0])}.</p>"
    rows = ((_spaced(reason), str(times)) for reason, times in sorted(counts.items(), key=lambda item: -item[1]))
    return table(f"Refused {what}", (what, "times"), rows, numbers=(1,))


def _notices(history: FlightHistory) -> str:
    shown = history.notices[:_MAX_NOTICES]
    rows = (
        (f"{n.at_s - history.counts.first_s:.1f}", str(n.sysid) if n.sysid is not None else "fleet", n.level, n.text)
        for n in shown
    )
    left_out = len(history.notices) - len(shown)
    more = f"<p>{left_out} further lines are left out.</p>" if left_out else ""
    return table("Messages to the operator", ("s", "vehicle", "level", "text"), rows, numbers=(0,)) + more


def _spaced(reason: str) -> str:
    return reason.replace("_", " ")


_NIS_TICKS = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e5, 1e6)


def _draw_map(figure: Any, ink: Ink, *, frame: LocalFrame, located: Mapping[int, Sequence[VehicleEntry]]) -> None:
    """Draw the tracks in the fleet's frame; those without GPS have another colour."""
    axes = figure.subplots()
    for sysid, track in sorted(located.items()):
        if not track:
            continue
        points = np.array([_place(frame, entry) for entry in track])
        lost = np.array([[entry.vehicle.gps_state in WITHOUT_GPS] for entry in track])
        axes.plot(*points.T, color=ink.blue, lw=1)
        axes.plot(*np.where(lost, points, np.nan).T, color=ink.red, lw=2)
        axes.annotate(f" {sysid}", points[-1])
    axes.plot([], [], color=ink.blue, lw=1, label="with GPS")
    axes.plot([], [], color=ink.red, lw=2, label="without GPS: from ranges")
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2)


def _draw_vehicle(figure: Any, ink: Ink, *, history: FlightHistory, track: Sequence[VehicleEntry]) -> None:
    """Draw one vehicle over time: its bounds, HDOP, ranges in use and NIS.

    The bounds are the protection level, the 95 % bound and one sigma. The NIS has its 95 % band. Times without GPS are shaded.
    """
    from matplotlib import ticker

    start_s = history.counts.first_s
    t = [entry.at_s - start_s for entry in track]
    views = [entry.vehicle for entry in track]
    bound, hdop, nis = figure.subplots(3, 1, sharex=True)
    bound.plot(t, [_or_nan(v.hpl_m) for v in views], color=ink.grey, lw=1, label="protection level, m")
    bound.plot(t, [_or_nan(v.bound_95_m) for v in views], color=ink.red, lw=1, label="95 % bound, m")
    bound.plot(t, [_or_nan(v.sigma_h_m) for v in views], color=ink.blue, lw=1, label="1-sigma, m")
    hdop.plot(t, [_or_nan(v.hdop) for v in views], color=ink.blue, lw=1, label="HDOP")
    hdop.step(t, [v.ranges_in_use for v in views], color=ink.grey, lw=1, where="post", label="ranges in use")
    known = [(at, v.consistency) for at, v in zip(t, views, strict=True) if v.consistency is not None]
    times = [at for at, _ in known]
    nis.fill_between(times, [c.band_low for _, c in known], [c.band_high for _, c in known], color=ink.band, label="95 % band")
    nis.plot(times, [c.nis_median for _, c in known], color=ink.blue, lw=1, label="median NIS of its ranges, refused ones too")
    nis.set(xlabel="s since the first frame", yscale="symlog")
    nis.yaxis.set_major_locator(ticker.FixedLocator(_NIS_TICKS))
    nis.yaxis.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))
    lost = [v.gps_state in WITHOUT_GPS for v in views]
    for axes in (bound, hdop, nis):
        axes.fill_between(t, 0.0, 1.0, where=lost, color=ink.red, alpha=0.08, lw=0, transform=axes.get_xaxis_transform())
        axes.set_xlim(0.0, max(history.counts.last_s - start_s, 1e-3))
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left")


def _place(frame: LocalFrame, entry: VehicleEntry) -> tuple[float, float]:
    v = entry.vehicle
    assert v.lat_deg is not None
    assert v.lon_deg is not None
    assert v.alt_msl_m is not None
    return frame.enu_from_geodetic(v.lat_deg, v.lon_deg, v.alt_msl_m)[:2]


def _or_nan(value: float | None) -> float:
    return value if value is not None else float("nan")
