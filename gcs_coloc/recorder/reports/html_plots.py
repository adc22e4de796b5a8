"""The plots of a flight's report: the map, and each denied vehicle over time.

They are PNG in data URLs. Each is drawn twice, for a light page and for a dark one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.recorder.flight_history import WITHOUT_GPS, FlightHistory
from gcs_coloc.recorder.journal import VehicleEntry
from gcs_coloc.recorder.reports.html_page import Ink, PlotImage, in_both_inks

_NIS_TICKS = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e5, 1e6)


def map_picture(history: FlightHistory) -> PlotImage | None:
    """Draw the tracks in the fleet's frame; None where no vehicle was located.

    Those without GPS have another colour.
    """
    located = {sysid: [e for e in track if e.vehicle.lat_deg is not None] for sysid, track in history.tracks.items()}
    frame = history.frame
    if frame is None or not any(located.values()):
        return None
    return in_both_inks(lambda figure, ink: _draw_map(figure, ink, frame, located))


def vehicle_picture(history: FlightHistory, track: Sequence[VehicleEntry]) -> PlotImage:
    """Draw one vehicle over time: its bounds, HDOP, ranges in use and NIS.

    The bounds are the protection level, the 95 % bound and one sigma. The NIS has its 95 % band. Times without GPS are shaded.
    """
    return in_both_inks(lambda figure, ink: _draw_vehicle(figure, ink, history, track))


def _draw_map(figure: Any, ink: Ink, frame: LocalFrame, located: Mapping[int, Sequence[VehicleEntry]]) -> None:
    axes = figure.subplots()
    for sysid, track in sorted(located.items()):
        if not track:
            continue
        points = [_place(frame, entry) for entry in track]
        lost = [entry.vehicle.gps_state in WITHOUT_GPS for entry in track]
        east, north = [p[0] for p in points], [p[1] for p in points]
        axes.plot(east, north, color=ink.blue, lw=1)
        axes.plot(*_only(east, north, lost), color=ink.red, lw=2)
        axes.annotate(f" {sysid}", points[-1])
    axes.plot([], [], color=ink.blue, lw=1, label="with GPS")
    axes.plot([], [], color=ink.red, lw=2, label="without GPS: from ranges")
    axes.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2)


def _draw_vehicle(figure: Any, ink: Ink, history: FlightHistory, track: Sequence[VehicleEntry]) -> None:
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
    for axes in (bound, hdop, nis):
        for begin_s, end_s in _spans(t, [v.gps_state in WITHOUT_GPS for v in views]):
            axes.axvspan(begin_s, end_s, color=ink.red, alpha=0.08, lw=0)
        axes.set_xlim(0.0, max(history.counts.last_s - start_s, 1e-3))
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.legend(loc="upper left")


def _spans(t: Sequence[float], flags: Sequence[bool]) -> list[tuple[float, float]]:
    spans: list[tuple[float, float]] = []
    begin_s: float | None = None
    for at_s, flag in zip(t, flags, strict=True):
        if flag and begin_s is None:
            begin_s = at_s
        elif not flag and begin_s is not None:
            spans.append((begin_s, at_s))
            begin_s = None
    if begin_s is not None:
        spans.append((begin_s, t[-1]))
    return spans


def _place(frame: LocalFrame, entry: VehicleEntry) -> tuple[float, float]:
    v = entry.vehicle
    assert v.lat_deg is not None
    assert v.lon_deg is not None
    assert v.alt_msl_m is not None
    return frame.enu_from_geodetic(v.lat_deg, v.lon_deg, v.alt_msl_m)[:2]


def _only(x: list[float], y: list[float], flags: list[bool]) -> tuple[list[float], list[float]]:
    nan = float("nan")
    return [a if f else nan for a, f in zip(x, flags, strict=True)], [b if f else nan for b, f in zip(y, flags, strict=True)]


def _or_nan(value: float | None) -> float:
    return value if value is not None else float("nan")
