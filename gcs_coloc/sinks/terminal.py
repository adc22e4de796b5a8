"""The terminal on which one thread draws a live table, and others print lines above it."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.live import Live
from rich.table import Table
from rich.text import Text

from gcs_coloc.core.alarms.alarms import LightColour
from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.core.readiness.vehicle_readiness import ReadinessState
from gcs_coloc.core.snapshot import FleetSnapshot, VehicleSnapshot
from gcs_coloc.sinks.fleet_lines import age, called, metres, number, out_line, standby_line
from gcs_coloc.sinks.watched_fleets import WORST_FIRST, FleetShown, Presence

_LAST_TABLE_S = 1.0
"""How long the end of the program waits for the last table. Chosen: a slow terminal, and no longer than a person waits."""


class SharedConsole(Console):
    """A console on which one thread draws a table and others print lines above it.

    rich works out how far up the table before begins, then draws: what another thread prints in between would leave a piece of
    that table behind. `lock` is held while either is under way.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.lock = threading.RLock()

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, while nobody else prints."""
        with self.lock:
            super().print(*objects, **options)


class LiveTable:
    """Always draws the newest table; those that came while the terminal was stopped are left out."""

    def __init__(self, console: SharedConsole) -> None:
        self._console = console
        self._newest: RenderableType | None = None
        self._wake = threading.Event()
        self._ending = False
        self._drawing = threading.Thread(target=self._draw, name="table", daemon=True)
        self._drawing.start()

    def show(self, table: RenderableType) -> None:
        """Draw a table in place of the one before; never waits. It is rendered on the thread."""
        self._newest = table
        self._wake.set()

    def close(self) -> None:
        """End with the last table on the screen; a terminal that is stopped is given up after a moment."""
        self._ending = True
        self._wake.set()
        self._drawing.join(_LAST_TABLE_S)

    def _draw(self) -> None:
        # Standard output and error stay what they are: they would wait for this very terminal.
        live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
        with self._console.lock:
            live.start()
        while not self._ending:
            self._wake.wait()
            self._wake.clear()
            table, self._newest = self._newest, None
            if table is not None:
                with self._console.lock:
                    live.update(table, refresh=True)
        with self._console.lock:
            live.stop()


_GPS_STYLES = {
    GpsState.FAILED: "bold red",
    GpsState.SUSPECT: "yellow",
    GpsState.RECOVERING: "cyan",
    GpsState.UNKNOWN: "dim",
    GpsState.HEALTHY: "green",
}
"""How each state is written; the most serious state first."""
_SEVERITY = {state: place for place, state in enumerate(_GPS_STYLES)}
_HEADINGS = ("vehicle", "GPS", "heard", "latitude", "longitude", "95 %", "HPL", "ranges", "aiding")
_LEFT = ("vehicle", "GPS", "aiding")
_READY = {
    ReadinessState.READY: ("ready", "green"),
    ReadinessState.DEGRADED: ("degraded", "yellow"),
    ReadinessState.NOT_READY: ("not ready", "yellow"),
    ReadinessState.UNKNOWN: ("-", "dim"),
}
"""How the readiness of a healthy vehicle is written: nothing is sent to it, and this is what it would have if its GPS failed."""
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
        # Where there is no room for all, the end of a name gives way, and no digit.
        table.add_column(heading, no_wrap=heading != "vehicle", justify="left" if heading in _LEFT else "right")
    for v in vehicles:
        table.add_row(
            Text(called(v), no_wrap=True, overflow="ellipsis"),
            Text(v.gps_state, style=_GPS_STYLES[GpsState(v.gps_state)]),
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
    return Text("-") if v.gps_state == GpsState.HEALTHY.value else Text("no fix", style="bold red")


_LIGHT_STYLES: dict[LightColour, str] = {"good": "green", "caution": "yellow", "bad": "bold red", "unknown": "dim"}
_LIGHT_WORDS: dict[LightColour, str] = {"good": "good", "caution": "caution", "bad": "alarm", "unknown": "unknown"}
_FLEETS_HEADINGS = tuple(map(Text, ("fleet", "host", "state", "heard")))
_STATE_COLUMN = 2
_NAME_WIDTH = 18
"""Columns that a name has at most. Chosen: two names and a time leave half of 80 columns for the state."""


class FleetsTable:
    """All fleets within the height of the terminal.

    Lines for which there is no room are counted. `problem` stands above the table.
    """

    def __init__(self, fleets: Iterable[FleetShown], problem: str | None) -> None:
        self._fleets = tuple(fleets)
        self._problem = problem

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """As rich's protocol says."""
        if self._problem is not None:
            yield Text(self._problem, style="bold red")
        if not self._fleets:
            yield "no fleet heard yet"
            return
        rows = [row for fleet in self._fleets for row in _fleet_rows(fleet)]
        room = max(options.height or console.height, 8) - 4 - (self._problem is not None)
        table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
        # The reasons are cut first: they are long, and the page has them in full.
        widths = [
            min(max(len(row[column]) for row in [_FLEETS_HEADINGS, *rows]), _NAME_WIDTH)
            for column in range(len(_FLEETS_HEADINGS))
        ]
        widths[_STATE_COLUMN] = max(options.max_width - sum(widths) + widths[_STATE_COLUMN] - len(widths), _NAME_WIDTH)
        for heading, width in zip(_FLEETS_HEADINGS, widths, strict=True):
            table.add_column(heading, no_wrap=True, overflow="ellipsis", max_width=width)
        for row in rows[:room]:
            table.add_row(*row)
        yield table
        if len(rows) > room:
            yield f"and {len(rows) - room} more lines; the page shows all"


def fleet_line(fleet: FleetShown) -> str:
    """One fleet in one plain line."""
    problem = f"; {fleet.problem}" if fleet.problem is not None else ""
    return f"fleet {fleet.name} on {fleet.host or 'an unknown host'}: {_fleet_state(fleet)}{problem}"


def _fleet_rows(fleet: FleetShown) -> Iterator[tuple[Text, ...]]:
    style = _LIGHT_STYLES[fleet.light]
    heard = age(fleet.age_s) if fleet.age_s is not None else "-"
    yield Text(fleet.name, style="bold"), Text(fleet.host or "unknown"), Text(_fleet_state(fleet), style=style), Text(heard)
    if fleet.problem is not None:
        yield Text(""), Text(""), Text(fleet.problem, style="yellow"), Text("")
    if fleet.presence is not Presence.LIVE or fleet.overview is None:
        return
    for light in ("bad", "caution"):
        for v in fleet.overview.vehicles:
            if v.light == light:
                called = f"  {v.sysid} {v.name}".rstrip()
                yield (
                    Text(called),
                    Text(_LIGHT_WORDS[v.light], style=_LIGHT_STYLES[v.light]),
                    Text(v.reason),
                    Text(f"{v.age_s:.1f} s"),
                )


def _fleet_state(fleet: FleetShown) -> str:
    vehicles = fleet.overview.vehicles if fleet.overview is not None else ()
    by_light = Counter(v.light for v in vehicles)
    counts = ", ".join(f"{by_light[light]} {_LIGHT_WORDS[light]}" for light in WORST_FIRST if by_light[light])
    if fleet.presence is Presence.LIVE:
        return counts or "no vehicle heard yet"
    return f"{fleet.text}{f'; was: {counts}' if counts else ''}"
