"""The operator's console: a live table on a terminal, plain log lines elsewhere."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping

from rich.console import Group
from rich.table import Table
from rich.text import Text

from gcs_coloc.core.messages.outbound import ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.sinks.event_bus import Subscription, level_and_text
from gcs_coloc.sinks.live_table import LiveTable, SharedConsole

log = logging.getLogger("gcs_coloc")

_LEVELS = {"info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
_STYLES = {"healthy": "green", "suspect": "yellow", "failed": "bold red", "recovering": "cyan", "unknown": "dim"}
PLAIN_EVERY_S = 5.0
"""Period of the log lines of all vehicles where there is no terminal. Chosen: a log of a day stays readable."""


async def show(events: Mapping[str, Subscription], console: SharedConsole) -> None:
    """Show the events of each fleet, by its name, for ever: live tables where `console` is a terminal, else log lines."""
    async with asyncio.TaskGroup() as group:
        if not console.is_terminal:
            for name, subscription in events.items():
                group.create_task(_log_lines(name, subscription))
            return
        snapshots: dict[str, FleetSnapshot] = {}
        live = LiveTable(console)
        try:
            followers = [
                group.create_task(_show_snapshots(name, subscription, snapshots, live)) for name, subscription in events.items()
            ]
            await asyncio.wait(followers)
        finally:
            live.close()


async def _show_snapshots(name: str, subscription: Subscription, snapshots: dict[str, FleetSnapshot], live: LiveTable) -> None:
    while True:
        event = await subscription.get()
        if isinstance(event, FleetSnapshot):
            snapshots[name] = event
            now = sorted(snapshots.items())
            live.show(lambda now=now: Group(*(table(snapshot, name) for name, snapshot in now)))  # type: ignore[misc]
        else:
            _log_event(name, event)


async def _log_lines(name: str, subscription: Subscription) -> None:
    due_s = float("-inf")
    while True:
        event = await subscription.get()
        if not isinstance(event, FleetSnapshot):
            _log_event(name, event)
        elif event.at_s >= due_s:
            due_s = event.at_s + PLAIN_EVERY_S
            for vehicle in event.vehicles:
                log.info("%s%s", _of(name), line(vehicle))
            for out in event.outs:
                log.info("%s%s", _of(name), out_line(out))


def _of(name: str) -> str:
    """The beginning of a line about a fleet; one that is alone has no name."""
    return f"{name}: " if name else ""


def _log_event(name: str, event: ToOperator) -> None:
    level, text = level_and_text(event)
    who = f"vehicle {event.sysid}: " if event.sysid is not None else ""
    log.log(_LEVELS[level], "%s%s%s", _of(name), who, text)


def line(v: VehicleSnapshot) -> str:
    """One vehicle in one plain line."""
    return (
        f"vehicle {v.sysid}: last heard {v.age_s:.1f} s ago, GPS {v.gps_state} ({v.gps_reason}), position {_where(v)}, "
        f"1-sigma {_number(v.sigma_h_m, 'm')}, HDOP {_number(v.hdop)}, {v.ranges_in_use} ranges in use, aiding {v.aiding}"
    )


def out_line(out: OutSnapshot) -> str:
    """The ground tools behind one connection string in one plain line."""
    return (
        f"ground tools on {out.name}: {out.tools}, frames sent {out.frames_sent}, accepted {out.frames_accepted}, "
        f"dropped {out.dropped}, refused {out.refused}"
    )


def table(snapshot: FleetSnapshot, name: str = "") -> Table:
    """The fleet as a table, under its name if it has one."""
    refused = sum(snapshot.refused.values())
    below = [*([f"refused: {refused}"] if refused else []), *map(out_line, snapshot.outs)]
    out = Table(
        title=f"gcs-coloc{f', fleet {name}' if name else ''}, estimator {snapshot.estimator}",
        caption="\n".join(below) or None,
    )
    for heading in ("vehicle", "last heard", "GPS", "reason", "position", "1-sigma", "HDOP", "ranges", "aiding"):
        out.add_column(heading)
    for v in snapshot.vehicles:
        out.add_row(
            str(v.sysid),
            f"{v.age_s:.1f} s",
            Text(v.gps_state, style=_STYLES[v.gps_state]),
            v.gps_reason,
            _where(v),
            _number(v.sigma_h_m, "m"),
            _number(v.hdop),
            str(v.ranges_in_use),
            v.aiding,
        )
    if not snapshot.vehicles:
        out.add_row("none", "", "", "no vehicle heard yet", "", "", "", "", "")
    return out


def _where(v: VehicleSnapshot) -> str:
    if v.lat_deg is None or v.lon_deg is None or v.alt_msl_m is None:
        return f"unknown: {v.no_estimate_reason}"
    return f"{v.lat_deg:.6f} {v.lon_deg:.6f} {v.alt_msl_m:.0f} m"


def _number(value: float | None, unit: str = "") -> str:
    return f"{value:.1f} {unit}".rstrip() if value is not None else "-"
