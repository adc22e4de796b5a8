"""The fleet as a table on a terminal: one line a vehicle, the most serious first.

The reasons of the vehicles that need one stand below it.
"""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState
from gcs_coloc.core.snapshot import FleetSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot

_STYLES = {
    GpsState.FAILED: "bold red",
    GpsState.SUSPECT: "yellow",
    GpsState.RECOVERING: "cyan",
    GpsState.UNKNOWN: "dim",
    GpsState.HEALTHY: "green",
}
"""How each state is written; the most serious state first."""
_SEVERITY = {state: place for place, state in enumerate(_STYLES)}
_HEADINGS = ("vehicle", "GPS", "heard", "latitude", "longitude", "95 %", "HPL", "ranges", "aiding")
_LEFT = ("vehicle", "GPS", "aiding")
_READY = {
    ReadinessState.READY: ("ready", "green"),
    ReadinessState.DEGRADED: ("weak", "yellow"),
    ReadinessState.NOT_READY: ("none", "bold red"),
    ReadinessState.UNKNOWN: ("-", "dim"),
}
"""How it is written what aiding a healthy vehicle would have if its GPS failed."""
_MIN_ROWS = 3
"""Rows of a fleet that are shown where the terminal has room for fewer. Chosen: the most serious must be seen."""


class FleetTables:
    """The fleets, by their names, within the height of the terminal; what has no room is counted."""

    def __init__(self, snapshots: Mapping[str, FleetSnapshot]) -> None:
        self._snapshots = sorted(snapshots.items())

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """As rich's protocol says."""
        # The line of the cursor is below the table.
        height = (console.height - 1) // max(len(self._snapshots), 1)
        for name, snapshot in self._snapshots:
            yield from _fleet(snapshot, name, console, options.max_width, height)


def out_line(out: OutSnapshot) -> str:
    """The ground tools behind one connection string in one plain line."""
    return (
        f"ground tools on {out.name}: {out.tools}, frames sent {out.frames_sent}, accepted {out.frames_accepted}, "
        f"dropped {out.dropped}, refused {out.refused}"
    )


def standby_line(standby: StandbySnapshot) -> str:
    """The hot standby in one plain line."""
    heard = "never" if standby.other_age_s is None else f"{_age(standby.other_age_s)} ago"
    problem = f"; {standby.problem}" if standby.problem is not None else ""
    other = standby.other_state or "unknown"
    return f"hot standby: this service is {standby.state} ({standby.reason}), the other one {other}, last heard {heard}{problem}"


def vehicle_line(v: VehicleSnapshot) -> str:
    """One vehicle in one plain line."""
    return (
        f"vehicle {_called(v)}: last heard {v.age_s:.1f} s ago, GPS {v.gps_state} ({v.gps_reason}), position {_where(v)}, "
        f"95 % bound {_metres(v.bound_95_m)}, HPL {_metres(v.hpl_m)}, HDOP {_number(v.hdop)}, {v.ranges_in_use} ranges in use, "
        f"aiding {v.aiding}{_without_gps(v)}"
    )


def _fleet(snapshot: FleetSnapshot, name: str, console: Console, width: int, height: int) -> list[RenderableType]:
    """Return the lines of one fleet, `height` of them at most.

    They are more where the most serious vehicles and the lines below the table need them.
    """

    def lines(text: str) -> int:
        return len(Text(text).wrap(console, width))

    title = f"gcs-coloc{f', fleet {name}' if name else ''}, estimator {snapshot.estimator}"
    refused = ", ".join(f"{reason} {times}" for reason, times in snapshot.refused.items() if times)
    standby = [standby_line(snapshot.standby)] if snapshot.standby is not None else []
    below = [*standby, *([f"refused: {refused}"] if refused else []), *map(out_line, snapshot.outs)]
    if not snapshot.vehicles:
        return [title, "no vehicle heard yet", *below]
    vehicles = sorted(snapshot.vehicles, key=lambda v: (_SEVERITY[GpsState(v.gps_state)], v.sysid))
    room = height - 2 - sum(map(lines, below))
    reasons: list[str] = []
    for text in filter(None, map(_reason, vehicles)):
        if sum(map(lines, [*reasons, text])) > max(room - min(len(vehicles), _MIN_ROWS) - 1, 0):
            break
        reasons.append(text)
    room -= sum(map(lines, reasons))
    shown = vehicles if len(vehicles) <= room else vehicles[: max(room - 1, _MIN_ROWS)]
    left_out = vehicles[len(shown) :]
    if left_out:
        troubled = sum(_reason(v) is not None for v in left_out)
        below.insert(0, f"and {len(left_out)} more vehicles, {f'{troubled} of them not healthy' if troubled else 'all healthy'}")
    return [title, _rows(shown), *reasons, *below]


def _rows(vehicles: list[VehicleSnapshot]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in _HEADINGS:
        table.add_column(heading, no_wrap=True, justify="left" if heading in _LEFT else "right")
    for v in vehicles:
        table.add_row(
            _called(v),
            Text(v.gps_state, style=_STYLES[GpsState(v.gps_state)]),
            _age(v.age_s),
            _number(v.lat_deg, 5),
            _number(v.lon_deg, 5),
            _metres(v.bound_95_m),
            _metres(v.hpl_m),
            str(v.ranges_in_use),
            _aiding(v),
        )
    return table


def _without_gps(v: VehicleSnapshot) -> str:
    if v.readiness is None:
        return ""
    state = v.readiness.state.value.replace("_", " ")
    return f", without GPS {state}{f' ({v.readiness.text})' if v.readiness.text else ''}"


def _called(v: VehicleSnapshot) -> str:
    return f"{v.sysid} {v.name}".rstrip()


def _reason(v: VehicleSnapshot) -> str | None:
    """Return why a vehicle is not as it should be, and its aiding; None where there is no reason."""
    if v.gps_state == GpsState.HEALTHY.value and v.inhibit_reason is None:
        found = v.readiness
        return f"{_called(v)}: would be lost without GPS: {found.text}" if found is not None and found.is_lost else None
    position = f", position unknown: {v.no_estimate_reason}" if v.lat_deg is None else f", HDOP {_number(v.hdop)}"
    inhibited = f", aiding inhibited: {v.inhibit_reason}" if v.inhibit_reason is not None else ""
    return f"{_called(v)}: {v.gps_reason}{position}, {v.aiding}{inhibited}"


def _aiding(v: VehicleSnapshot) -> Text:
    if v.aiding_has_fix:
        return Text("fix")
    if v.readiness is not None:
        return Text(*_READY[v.readiness.state])
    return Text("-" if v.gps_state == GpsState.HEALTHY.value else "no fix")


def _where(v: VehicleSnapshot) -> str:
    if v.lat_deg is None or v.lon_deg is None or v.alt_msl_m is None:
        return f"unknown: {v.no_estimate_reason}"
    return f"{v.lat_deg:.6f} {v.lon_deg:.6f} {v.alt_msl_m:.0f} m"


def _age(seconds: float) -> str:
    """A time in at most six characters."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5940.0 else f"{min(seconds / 3600.0, 9999.0):.0f} h"


def _metres(metres: float | None) -> str:
    """A length in at most six characters."""
    if metres is None:
        return "-"
    return f"{metres:.1f} m" if metres < 99.95 else f"{metres:.0f} m" if metres < 9999.5 else f"{metres / 1000.0:.0f} km"


def _number(value: float | None, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if value is not None else "-"
