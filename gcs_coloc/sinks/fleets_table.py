"""All fleets as a table on a terminal: one line a fleet, the most serious first.

The vehicles of a fleet that need a person stand below its line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from gcs_coloc.core.alarms.alarms import LightColour
from gcs_coloc.sinks.watched_fleets import WORST_FIRST, FleetShown, Presence

_STYLES: dict[LightColour, str] = {"good": "green", "caution": "yellow", "bad": "bold red", "unknown": "dim"}
_WORDS: dict[LightColour, str] = {"good": "good", "caution": "caution", "bad": "alarm", "unknown": "unknown"}
_HEADINGS = tuple(map(Text, ("fleet", "host", "state", "heard")))
_STATE = 2
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
        rows = [row for fleet in self._fleets for row in _rows(fleet)]
        room = max(options.height or console.height, 8) - 4 - (self._problem is not None)
        table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
        # The reasons are cut first: they are long, and the page has them in full.
        widths = [min(max(len(row[column]) for row in [_HEADINGS, *rows]), _NAME_WIDTH) for column in range(len(_HEADINGS))]
        widths[_STATE] = max(options.max_width - sum(widths) + widths[_STATE] - len(widths), _NAME_WIDTH)
        for heading, width in zip(_HEADINGS, widths, strict=True):
            table.add_column(heading, no_wrap=True, overflow="ellipsis", max_width=width)
        for row in rows[:room]:
            table.add_row(*row)
        yield table
        if len(rows) > room:
            yield f"and {len(rows) - room} more lines; the page shows all"


def fleet_line(fleet: FleetShown) -> str:
    """One fleet in one plain line."""
    problem = f"; {fleet.problem}" if fleet.problem is not None else ""
    return f"fleet {fleet.name} on {fleet.host or 'an unknown host'}: {_state(fleet)}{problem}"


def _rows(fleet: FleetShown) -> Iterator[tuple[Text, ...]]:
    style = _STYLES[fleet.light]
    heard = f"{fleet.age_s:.1f} s" if fleet.age_s is not None and fleet.age_s < 60.0 else "-"
    if fleet.age_s is not None and fleet.age_s >= 60.0:
        heard = f"{fleet.age_s / 60.0:.0f} min"
    yield Text(fleet.name, style="bold"), Text(fleet.host or "unknown"), Text(_state(fleet), style=style), Text(heard)
    if fleet.problem is not None:
        yield Text(""), Text(""), Text(fleet.problem, style="yellow"), Text("")
    if fleet.presence is not Presence.LIVE or fleet.overview is None:
        return
    for light in ("bad", "caution"):
        for v in fleet.overview.vehicles:
            if v.light == light:
                called = f"  {v.sysid} {v.name}".rstrip()
                yield Text(called), Text(_WORDS[v.light], style=_STYLES[v.light]), Text(v.reason), Text(f"{v.age_s:.1f} s")


def _state(fleet: FleetShown) -> str:
    vehicles = fleet.overview.vehicles if fleet.overview is not None else ()
    by_light = Counter(v.light for v in vehicles)
    counts = ", ".join(f"{by_light[light]} {_WORDS[light]}" for light in WORST_FIRST if by_light[light])
    if fleet.presence is Presence.LIVE:
        return counts or "no vehicle heard yet"
    return f"{fleet.text}{f'; was: {counts}' if counts else ''}"
