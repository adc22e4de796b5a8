"""`python -m bench [--quick] [--json FILE] [SECTION ...]`: run the benchmarks and print one table.

By default those of speed; a study, of which some take hours, is named, or `all` is.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bench import (
    accuracy,
    decode,
    flood,
    integrity,
    latency,
    live,
    memory,
    operator_side,
    readiness,
    returning,
    scaling,
    seek,
    service_cpu,
    startup,
    step,
    studies,
    takeover,
    unused,
    watch,
)
from bench.figures import Figure

_Section = Callable[[bool], list[Figure]]
_SPEED: dict[str, _Section] = {
    "start": startup.measure,
    "decode": decode.measure,
    "unused": unused.measure,
    "step": step.measure,
    "latency": latency.measure,
    "throughput": live.measure_throughput,
    "vehicles": live.measure_vehicles,
    "processes": live.measure_processes,
    "scaling": scaling.measure,
    "service": service_cpu.measure,
    "memory": memory.measure,
    "seek": seek.measure,
    "readiness": readiness.measure,
    "studies": studies.measure,
    "takeover": takeover.measure,
    "watch": watch.measure,
}
_STUDIES: dict[str, _Section] = {
    "operator": operator_side.measure,
    "flood": flood.measure,
    "accuracy": accuracy.measure,
    "integrity": integrity.measure,
    "returning": returning.measure,
}
_SECTIONS = _SPEED | _STUDIES


def main() -> None:
    """Run the sections that are asked for, those of speed by default."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument(
        "sections",
        nargs="*",
        metavar="SECTION",
        help=f"speed (the default): {', '.join(_SPEED)}; studies: {', '.join(_STUDIES)}; or all",
    )
    parser.add_argument("--quick", action="store_true", help="shorter runs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to a file")
    arguments = parser.parse_args()
    for section in arguments.sections:
        if section not in (*_SECTIONS, "all"):
            parser.error(f"no section {section!r}; there are {', '.join(_SECTIONS)}, and all")
    sections = _SECTIONS if "all" in arguments.sections else arguments.sections or _SPEED
    figures: list[tuple[str, Figure]] = []
    for section in sections:
        print(f"{section} ...", file=sys.stderr)
        figures += [(section, figure) for figure in _SECTIONS[section](arguments.quick)]
    table = Table("section", "figure", "measured", "goal", "")
    for section, figure in figures:
        result = "" if figure.reached is None else ("reached" if figure.reached else "NOT reached")
        table.add_row(section, figure.name, figure.value, figure.goal, result)
    Console(width=150).print(table)
    if arguments.json is not None:
        told = [{"section": section, **asdict(figure)} for section, figure in figures]
        arguments.json.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
