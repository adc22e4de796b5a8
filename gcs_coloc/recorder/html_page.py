"""The parts that all HTML reports share: head, tables and pictures.

Pictures are drawn for a light page and for a dark one. A page loads nothing: pictures are PNG in data URLs.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from gcs_coloc.runtime.files import new_figure

_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<style>
:root { --page: #fff; --text: #1a1a1a; --line: #ccc; --bad: #a33c00 }
@media (prefers-color-scheme: dark) { :root { --page: #1b2128; --text: #e6eaee; --line: #36404a; --bad: #ff8a4c } }
body { font: 16px/1.45 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
  color: var(--text); background: var(--page); overflow-wrap: break-word }
.scroll { overflow-x: auto; margin: .6rem 0 } .scroll:focus-visible { outline: 2px solid }
table { border-collapse: collapse }
th, td { border-bottom: 1px solid var(--line); padding: .25rem .7rem; text-align: left }
td:last-child:not(.n) { min-width: 13rem }
td:not(.n) { min-width: 6rem; overflow-wrap: anywhere }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums }
img { max-width: 100% }
.bad { color: var(--bad); font-weight: 600 }
</style>
"""


@dataclass(frozen=True, slots=True)
class Ink:
    """The colours of the lines, and matplotlib's settings for everything else."""

    blue: str
    red: str
    grey: str
    band: str
    surroundings: Mapping[str, str] = field(default_factory=dict)


_PAPER, _TEXT, _LINE = "#1b2128", "#e6eaee", "#5c6670"
_LIGHT = Ink("#0072b2", "#d55e00", "#999999", "#d9d9d9")
_DARK = Ink(
    "#56b4e9",
    "#ff8a4c",
    "#8a949e",
    "#36404a",
    {
        **dict.fromkeys(("figure.facecolor", "axes.facecolor", "legend.facecolor"), _PAPER),
        **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), _TEXT),
        **dict.fromkeys(("axes.edgecolor", "legend.edgecolor", "grid.color"), _LINE),
    },
)


def document(title: str, parts: Iterable[str]) -> str:
    """One page: its title, which is its heading, too, and its parts."""
    begin = f"<title>{escape(title)}</title></head><body><main><h1>{escape(title)}</h1>"
    return "\n".join([_HEAD, begin, *parts, "</main></body></html>\n"])


def table(name: str, heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """One table under its name for screen readers; one that is too wide is scrolled, also by keyboard."""

    def cells(tag: str, row: Sequence[str]) -> str:
        kind = {True: ' class="n"', False: ""}
        return "".join(f"<{tag}{kind[i in numbers]}>{escape(text)}</{tag}>" for i, text in enumerate(row))

    head = f"<thead><tr>{cells('th', heads)}</tr></thead>" if any(heads) else ""
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    table = f"<table>{head}<tbody>{body}</tbody></table>"
    return f'<div class="scroll" tabindex="0" role="group" aria-label="{escape(name)}">{table}</div>'


def picture(alt: str, draw: Callable[[Any, Ink], None], size: tuple[float, float] = (9.0, 7.0)) -> str:
    """Draw a picture of a size in inches in both inks; the dark one is for readers who prefer dark pages."""
    light, dark = (_png(draw, ink, size) for ink in (_LIGHT, _DARK))
    source = f'<source media="(prefers-color-scheme: dark)" srcset="{dark}">'
    return f'<picture>{source}<img alt="{alt}" src="{light}"></picture>'


def _png(draw: Callable[[Any, Ink], None], ink: Ink, size: tuple[float, float]) -> str:
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context(dict(ink.surroundings)):
        figure = new_figure(size)
        draw(figure, ink)
        figure.savefig(buffer, format="png", dpi=100)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
