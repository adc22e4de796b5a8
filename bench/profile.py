"""Where a program's CPU time goes, by the parts of the service: what a figure that is not reached is printed with.

py-spy (extra `bench`) looks at the program from outside some hundred times a second; waiting is left out.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from bench.figures import Figure

_LOOKS_PER_S = 400
_LEAST_SHARE = 0.005
_ENDS_WITHIN_S = 20.0
_PACKAGE = "(gcs_coloc/"
# The first that fits; a part of the path says the rest.
_PARTS = (
    ("core/integrity/", "ranges against GPS positions (integrity)"),
    ("estimators/fleet/ekf/state.py", "filter's linear algebra"),
    ("estimators/", "filter"),
    ("core/aiding/", "aiding"),
    ("core/", "engine: health, clocks, frames, noise"),
    ("mavlink/", "decoding and encoding"),
    ("links/", "receiving, routes, sending"),
    ("", "the rest of the service"),
)


def where_it_goes(program: Sequence[str], drive: Callable[[subprocess.Popen[bytes]], object], within: str) -> Figure:
    """Run a program under py-spy, and put what it does below the function `within` (its qualified name) into shares.

    `drive` is given py-spy's process, of which the program is a child, and returns when it has seen enough.
    """
    name = "where its CPU time goes"
    py_spy = Path(sys.executable).with_name("py-spy")
    if not py_spy.exists():
        return Figure(name, "py-spy is not installed (pip install -e '.[bench]')")
    with tempfile.TemporaryDirectory() as directory:
        told, stacks = Path(directory) / "told", Path(directory) / "stacks"
        command = [str(py_spy), "record", "--rate", str(_LOOKS_PER_S), "--format", "raw", "--output", str(stacks), "--", *program]
        with told.open("wb") as words, subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=words, stderr=words) as process:
            try:
                drive(process)
            finally:
                process.send_signal(signal.SIGINT)
                process.wait(_ENDS_WITHIN_S)
        if not stacks.exists():
            return Figure(name, f"py-spy failed: {told.read_text(errors='replace').strip()[-200:]}")
        shares = shares_by_part(stacks.read_text(encoding="utf-8").splitlines(), within)
    total = sum(shares.values())
    told_shares = (f"{part} {looks / total:.0%}" for part, looks in shares.most_common() if looks >= _LEAST_SHARE * total)
    return Figure(name, f"{', '.join(told_shares)} (of {total} looks)")


def shares_by_part(stacks: Iterable[str], within: str) -> Counter[str]:
    """How often each part was seen at work, from stacks as py-spy writes them: frames from the outermost on, and a count."""
    shares: Counter[str] = Counter()
    for line in stacks:
        frames, _, count = line.rpartition(" ")
        _, found, inner = frames.rpartition(f";{within} (")
        if found:
            shares[_part(inner.split(";")[1:])] += int(count)
    return shares


def _part(frames: list[str]) -> str:
    for frame in reversed(frames):
        if _PACKAGE in frame:
            path = frame.partition(_PACKAGE)[2]
            return next(part for start, part in _PARTS if path.startswith(start))
    return "event loop and the rest"
