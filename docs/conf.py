"""How Sphinx builds the site: `make docs`. Sphinx reads its settings from this file only, not from pyproject.toml."""

import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from docutils import nodes  # noqa: E402
from docutils.utils.math.latex2mathml import tex2mathml  # noqa: E402
from sphinx.domains.python import PythonDomain  # noqa: E402

import gcs_coloc  # noqa: E402  (the tree that is documented, not another one that may be installed)

project = "gcs-coloc"
author = "The gcs-coloc developers"
release = gcs_coloc.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.apidoc"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]

# A page of the API reference for each package, so that every public name has its place. A page for each module
# takes minutes more.
apidoc_modules = [
    {
        "path": "../gcs_coloc",
        "destination": "reference/modules",
        "exclude_patterns": ["**/_generated/**"],
        "separate_modules": False,
        "module_first": True,
        "automodule_options": {"members", "undoc-members", "show-inheritance"},
    }
]
# Thousands of names would be in the side bar of every page.
toc_object_entries = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_use_type_comments = False  # there are none, and looking for them parses every module again
# The package offers names of its rooms, which are then found in two places.
suppress_warnings = ["ref.python"]

exclude_patterns = ["reference/modules/modules.rst"]  # an index above the package, which the package's own page is

# MathML, which browsers draw themselves: MathJax would be loaded from another site by every reader.
html_math_renderer = "mathml"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_title = f"gcs-coloc {release}"
html_theme_options = {"navigation_with_keys": True}
html_show_copyright = False


def paragraph(lines: list[str]) -> list[str]:
    """Lines of prose as reStructuredText: `code` stays code, everything else is taken literally."""
    parts = re.split(r"(`[^`]+`)", "\n".join(lines))
    parts = [f"``{part[1:-1].strip()}``" if i % 2 else re.sub(r"([*_|`\\])", r"\\\1", part) for i, part in enumerate(parts)]
    return "".join(parts).split("\n")


def plain_docstring(_app: object, _what: str, _name: str, _obj: object, _options: object, lines: list[str]) -> None:
    """Our docstrings are plain text with `code`, lists and indented blocks: this makes them reStructuredText."""
    out: list[str] = []
    run: list[str] = []
    literal = in_list = False

    def flush() -> None:
        if run:
            out.extend(["::", "", *(f"    {line}" for line in run), ""] if literal else [*paragraph(run), ""])
            run.clear()

    for line in lines:
        starts_item = bool(re.match(r"[-*] ", line))
        if not line.strip() or starts_item:
            flush()
        if not line.strip():
            in_list = False
            continue
        in_list = in_list or starts_item
        indented = line.startswith(" ") and not in_list
        if indented != literal:
            flush()
        literal = indented
        run.append(line.strip() if in_list and not starts_item else line)
        if in_list and not starts_item:
            run[-1] = "  " + run[-1]
    flush()
    lines[:] = out


def inline_math(writer: Any, node: nodes.math) -> None:
    """Write a formula within a sentence."""
    writer.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def display_math(writer: Any, node: nodes.math_block) -> None:
    """Write a formula on a line of its own, with the number in its `tag` behind it."""
    text = re.sub(r"\\tag\{([^}]*)\}", r"\\qquad (\1)", node.astext())
    writer.body.append(f'<div class="math">{tex2mathml(text.strip(), as_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Sphinx calls this once."""
    # Each reference is looked for among all names of the project, and most are one of a few: half of the build's time.
    PythonDomain.find_obj = cache(PythonDomain.find_obj)  # type: ignore[method-assign]
    app.add_html_math_renderer("mathml", (inline_math, None), (display_math, None))
    app.connect("autodoc-process-docstring", plain_docstring)
