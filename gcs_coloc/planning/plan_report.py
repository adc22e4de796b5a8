"""Report of a plan: its assessment as one HTML page that loads nothing.

The answer comes first, then map, tables and plots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.readiness.vehicle_readiness import IN_LINE_HDOP
from gcs_coloc.core.reasons import counted
from gcs_coloc.planning.assessment import Assessment, Outlook, Stretch
from gcs_coloc.planning.improvement import Improvement, no_improvement
from gcs_coloc.recorder.html_page import Ink, document, picture, table

_MOST_PLOTS = 12
"""Chosen: of a large fleet the vehicles with the least of a fix are drawn."""
_MOST_HDOP = 20.0  # chosen: the plot ends there; beyond it nothing is located
_MOST_PAIRS = 30  # chosen: as many as a page shows


def page(assessed: Assessment, improvement: Improvement | None, *, is_improvement_sought: bool = True) -> str:
    """Return the page as text.

    That no change helps is said only where one was sought.

    Raises:
        UsageError: matplotlib is not installed.
    """
    plan = assessed.plan
    title = f"Plan of {counted(len(plan.vehicles), 'vehicle')}"
    parts = [_answer(assessed, improvement, is_improvement_sought=is_improvement_sought)]
    alt = "Map of the ways, east over north; where a vehicle would have no fix in red"
    parts.append(picture(alt, partial(_draw_map, assessed=assessed)))
    parts.append(f"<p>East and north of {_place(plan.frame)}, where the first plan begins.</p>")
    parts.append(
        "<h2>Each vehicle alone without GPS</h2>" + _outlooks("Each vehicle alone without GPS", assessed, assessed.singles)
    )
    if assessed.pairs:
        parts.append("<h2>Two vehicles without GPS</h2>" + _pairs(assessed))
    shown = sorted(assessed.singles, key=lambda each: each.predicted.share_with_fix)[:_MOST_PLOTS]
    parts += [_vehicle(assessed, each) for each in sorted(shown, key=lambda each: each.predicted.sysid)]
    if len(shown) < len(assessed.singles):
        parts.append(
            f"<p>The other {len(assessed.singles) - len(shown)} vehicles have more of a fix; the CSV holds them all.</p>"
        )
    parts.append("<h2>Assumed</h2>" + _assumptions(assessed))
    parts += ["<h2>Skipped and taken as</h2>", *(f"<p>{escape(line)}</p>" for line in plan.remarks)] if plan.remarks else []
    return document(title, parts)


def _answer(assessed: Assessment, improvement: Improvement | None, *, is_improvement_sought: bool) -> str:
    worst = assessed.worst
    flown = [each for each in assessed.singles if len(each.predicted.at_s)]
    covered = sum(each.predicted.share_with_fix >= 1.0 for each in flown)
    lines = [f"{covered} of {len(flown)} vehicles would have a fix all along their way if their GPS failed."]
    if worst.worst is not None:
        share = worst.predicted.share_with_fix
        kind = "bad" if share < 1.0 else ""
        lines.append(
            f'<span class="{kind}">Vehicle {worst.predicted.sysid} is worst: a fix for {share:.1%} of its flight.</span> '
            f"{escape(_stretch(worst.worst))}."
        )
    if improvement is not None:
        lines.append(f"What helps it most: {escape(improvement.text)}.")
    elif is_improvement_sought and (none := no_improvement(assessed)):
        lines.append(none)
    if any(each.cannot_tell > 0.0 for each in assessed.singles):
        lines.append(
            "Where a vehicle is without an estimate, ranges one node, or is in one line with its peers "
            f"(HDOP {IN_LINE_HDOP:g} or more), the noise of the day decides how far off it is and when it is found again. "
            "There the prediction cannot tell: its bounds are upper ones, mostly far above the errors that come."
        )
    lines.append(
        "Everything is computed by the service's own filter along the planned ways, without wind, blocked ranges and faults."
    )
    return "".join(f"<p>{line}</p>" for line in lines)


def _stretch(worst: Stretch) -> str:
    when = f"{_clock(worst.from_s)} to {_clock(worst.until_s)}"
    return f"Worst from {when}: {worst.cause}" if worst.has_fix else f"No fix from {when}: {worst.cause}"


def _outlooks(name: str, assessed: Assessment, outlooks: Sequence[Outlook]) -> str:
    heads = ("vehicle", "plan", "with a fix", "cannot tell", "95 %, m", "HPL, m", "worst stretch")
    rows = [
        (
            str(each.predicted.sysid),
            assessed.plan.vehicle(each.predicted.sysid).name,
            f"{each.predicted.share_with_fix:.1%}",
            f"{each.cannot_tell:.1%}",
            _metres(each.median_bound_95_m),
            _metres(each.median_hpl_m),
            _stretch(each.worst) if each.worst is not None else "not in flight",
        )
        for each in outlooks
    ]
    return table(name, heads, rows, numbers=(0, 2, 3, 4, 5)) + "<p>95 % bound and protection level HPL: medians.</p>"


def _pairs(assessed: Assessment) -> str:
    worst = sorted(assessed.pairs, key=lambda each: each.predicted.share_with_fix)[:_MOST_PAIRS]
    rows = [
        (
            " and ".join(map(str, each.predicted.denied)),
            str(each.predicted.sysid),
            f"{each.predicted.share_with_fix:.1%}",
            _metres(each.median_hpl_m),
            _stretch(each.worst) if each.worst is not None else "not in flight",
        )
        for each in worst
    ]
    left = len(assessed.pairs) - len(worst)
    more = f"<p>{left} better cases are left out; the CSV holds them all.</p>" if left else ""
    heads = ("without GPS", "vehicle", "with a fix", "HPL, m", "worst stretch")
    return table("Two vehicles without GPS", heads, rows, numbers=(1, 2, 3)) + more


def _vehicle(assessed: Assessment, each: Outlook) -> str:
    sysid = each.predicted.sysid
    title = f"Vehicle {sysid}"
    alt = f"Vehicle {sysid} over time: protection level and 95 % bound in m, HDOP, nodes ranged"
    if not len(each.predicted.at_s):
        return f"<h2>{title}</h2><p>It ends its way before its GPS could fail.</p>"
    return f"<h2>{title}</h2>" + picture(alt, partial(_draw_vehicle, assessed=assessed, each=each), (9.0, 5.0))


def _assumptions(assessed: Assessment) -> str:
    a = assessed.plan.assumptions
    rows = [
        ("1-sigma of a range", f"{a.range_sigma_m:g} m, {a.range_rate_hz:g} times a second"),
        ("longest range", f"{a.max_range_m:g} m"),
        ("1-sigma of a position, each axis", f"{a.position_sigma_m:g} m, {a.position_white_share:.0%} of it new in each report"),
        ("1-sigma of a barometric height", f"{a.height_sigma_m:g} m"),
        ("planes send attitude and airspeed", "yes" if a.has_air_data else "no"),
        ("delays of the links are known", "yes" if a.delay_is_known else "no"),
        ("alert limit", f"{a.alert_limit_m:g} m"),
        ("stations", ", ".join(f"{s.station_id} (place known to {s.sigma_m:g} m)" for s in assessed.plan.stations) or "none"),
    ]
    return table("Assumed", ("", ""), rows)


def _draw_map(figure: Any, ink: Ink, *, assessed: Assessment) -> None:
    """Draw the ways of all vehicles, with the parts without a fix in another colour."""
    axes = figure.subplots()
    for each in assessed.singles:
        p = each.predicted
        path = assessed.plan.paths[p.sysid].positions_m
        axes.plot(path[:, 0], path[:, 1], color=ink.grey, lw=0.8)
        if not len(p.at_s):
            continue
        without = p.has_fix < 0.5
        east, north = p.position_enu_m[:, 0], p.position_enu_m[:, 1]
        axes.plot(np.where(without, np.nan, east), np.where(without, np.nan, north), color=ink.blue, lw=1.5)
        axes.plot(np.where(without, east, np.nan), np.where(without, north, np.nan), color=ink.red, lw=3.0)
        middle = len(east) // 2
        axes.annotate(f" {p.sysid}", (east[middle], north[middle]))
    for station in assessed.plan.stations:
        axes.plot(station.position_enu_m[0], station.position_enu_m[1], marker="^", color=ink.grey, ms=8)
        axes.annotate(f" station {station.station_id}", station.position_enu_m[:2])
    axes.plot([], [], color=ink.blue, lw=1.5, label="a fix without GPS")
    axes.plot([], [], color=ink.red, lw=3.0, label="no fix")
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2)


def _draw_vehicle(figure: Any, ink: Ink, *, assessed: Assessment, each: Outlook) -> None:
    """Draw one vehicle over time: protection level, 95 % bound, HDOP, nodes ranged, and the alert limit."""
    p, limit_m = each.predicted, assessed.plan.assumptions.alert_limit_m
    level, dilution = figure.subplots(2, 1, sharex=True)
    level.plot(p.at_s, np.minimum(p.hpl_m, 4.0 * limit_m), color=ink.grey, lw=1.2, label="protection level, m")
    level.plot(p.at_s, np.minimum(p.bound_95_m, 4.0 * limit_m), color=ink.blue, lw=1.2, label="95 % bound, m")
    level.axhline(limit_m, color=ink.red, lw=1.0, ls="--", label="alert limit, m")
    dilution.plot(p.at_s, np.minimum(p.hdop, _MOST_HDOP), color=ink.blue, lw=1.2, label=f"HDOP, at most {_MOST_HDOP:g} drawn")
    dilution.step(p.at_s, p.ranged, color=ink.grey, lw=1.0, where="post", label="nodes ranged")
    dilution.set(xlabel="s on the plan's clock")
    for axes in (level, dilution):
        axes.fill_between(
            p.at_s, 0.0, 1.0, where=p.has_fix < 0.5, color=ink.red, alpha=0.12, lw=0, transform=axes.get_xaxis_transform()
        )
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left", fontsize="small")


def _metres(value: float) -> str:
    return f"{value:.1f}" if math.isfinite(value) else "-"


def _clock(at_s: float) -> str:
    minutes, seconds = divmod(round(at_s), 60)
    return f"{minutes}:{seconds:02d}"


def _place(frame: LocalFrame) -> str:
    return f"{frame.lat_deg:.7f}, {frame.lon_deg:.7f}"
