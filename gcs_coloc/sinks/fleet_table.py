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
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.sinks.fleet_lines import age, called, metres, number, out_line, standby_line

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
            called(v),
            Text(v.gps_state, style=_STYLES[GpsState(v.gps_state)]),
            age(v.age_s),
            number(v.lat_deg, 5),
            number(v.lon_deg, 5),
            metres(v.bound_95_m),
            metres(v.hpl_m),
            str(v.ranges_in_use),
            _aiding(v),
        )
    return table


def _reason(v: VehicleSnapshot) -> str | None:
    """Return why a vehicle is not as it should be, and its aiding; None where there is no reason."""
    if v.gps_state == GpsState.HEALTHY.value and v.inhibit_reason is None:
        found = v.readiness
        return f"{called(v)}: would be lost without GPS: {found.text}" if found is not None and found.is_lost else None
    position = f", position unknown: {v.no_estimate_reason}" if v.lat_deg is None else f", HDOP {number(v.hdop)}"
    inhibited = f", aiding inhibited: {v.inhibit_reason}" if v.inhibit_reason is not None else ""
    return f"{called(v)}: {v.gps_reason}{position}, {v.aiding}{inhibited}"


def _aiding(v: VehicleSnapshot) -> Text:
    if v.aiding_has_fix:
        return Text("fix")
    if v.readiness is not None:
        return Text(*_READY[v.readiness.state])
    return Text("-" if v.gps_state == GpsState.HEALTHY.value else "no fix")
